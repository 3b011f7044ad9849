"""The bus fails, on a real SocketCAN interface: the service says so, and goes on when it is back."""

from __future__ import annotations

import subprocess

import can
import pytest

from tests.acceptance.machine.guest.kit import (
    Journal,
    add_bus,
    run,
    state_of,
    status,
    wait_for,
)
from tests.acceptance.machine.guest.rows import good_readings, row, seconds_to_good_data

BUS_OFF, BUS_ERROR, RESTARTED = 0x40, 0x80, 0x100  # linux/can/error.h
FOREIGN = 20_000  # frames, two thousand a second


pytestmark = pytest.mark.usefixtures("running")


@pytest.fixture(autouse=True)
def well() -> None:
    """Each test begins with a bus that is well."""
    # Not of the displacement's value: a virtual support that was held up has moved meanwhile, and may be doubted.
    wait_for("a bus that is well", lambda: state_of("can") == "ok")
    seconds_to_good_data(good_readings)


def send(*messages: can.Message) -> None:
    with can.Bus(interface="socketcan", channel="vcan0", fd=True, ignore_config=True) as bus:
        for message in messages:
            bus.send(message)


def test_the_interface_goes_down(journal: Journal) -> None:
    run("ip", "link", "set", "vcan0", "down")
    journal.wait_for("network interface vcan0 is down")
    run("ip", "link", "set", "vcan0", "up")
    row("vcan0 down and up", journal, seconds_to_good_data(good_readings))


def test_the_interface_is_deleted_and_made_again(journal: Journal) -> None:
    run("ip", "link", "delete", "vcan0")
    journal.wait_for("there is no network interface vcan0")
    add_bus()
    row("vcan0 deleted and made again", journal, seconds_to_good_data(good_readings))


def test_bus_off_is_told(journal: Journal) -> None:
    """As with a real controller nothing else comes in meanwhile: the virtual support stands still."""
    run("systemctl", "kill", "--signal=STOP", "machine-support")
    send(can.Message(is_error_frame=True, arbitration_id=BUS_OFF, data=bytes(8)))
    journal.wait_for("vcan0 is bus-off")
    run("systemctl", "kill", "--signal=CONT", "machine-support")
    send(can.Message(is_error_frame=True, arbitration_id=RESTARTED, data=bytes(8)))
    row("bus-off", journal, seconds_to_good_data(good_readings))


def test_own_frames_are_not_taken_for_the_controllers(journal: Journal) -> None:
    """A virtual interface counts what the daemon sends as received."""
    sent = status()["can"]["sent"]
    run("systemctl", "kill", "--signal=STOP", "machine-support")
    journal.wait_for("no frame at all")
    assert not any("frames arrive on vcan0" in line for line in journal.lines())
    assert status()["can"]["sent"] > sent + 5
    run("systemctl", "kill", "--signal=CONT", "machine-support")
    row("nothing comes on vcan0", journal, seconds_to_good_data(good_readings))


def test_error_frames_are_told(journal: Journal) -> None:
    """Some twenty a second, as of a wire that is loose, until the journal has it: a part speaks every ten seconds."""
    with can.Bus(interface="socketcan", channel="vcan0", fd=True, ignore_config=True) as bus:

        def told() -> bool:
            for _ in range(10):
                bus.send(can.Message(is_error_frame=True, arbitration_id=BUS_ERROR, data=bytes(8)))
            return any("error frames on vcan0" in line for line in journal.lines())

        wait_for("error frames in the journal", told)
    row("twenty error frames a second", journal, seconds_to_good_data(good_readings))
    assert sum(status()["can"]["error_kinds"].values()) > 0


def test_two_thousand_foreign_frames_a_second_do_no_harm(journal: Journal) -> None:
    """The kernel's filter keeps them away from the program."""
    before = good_readings()
    with subprocess.Popen(["cangen", "vcan0", "-g", "0.5", "-I", "2AA", "-L", "8", "-n", str(FOREIGN)]) as flood:
        seconds = seconds_to_good_data(good_readings)
        assert flood.wait() == 0
    assert good_readings() > before
    assert state_of("can") == "ok"
    row("2,000 foreign frames a second", journal, seconds)
