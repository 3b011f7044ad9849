"""The bus on a controller of its own, as on a support: bit rate, listen-only, bus-off, restart, a plug that is pulled.

The service is on can0, the virtual support sends on can1, and both are on one emulated bus.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cantools.database
import pytest
from cantools.database.can import Database

from tests.acceptance.machine.guest.kit import (
    PATIENCE_S,
    RAMSTROKE,
    RESULTS,
    SHARE,
    Journal,
    install_service,
    load_devices,
    properties,
    run,
    start_service,
    start_support,
    state_of,
    status,
    wait_for,
    write_config,
)
from tests.acceptance.machine.guest.rows import good_readings, no_good_data_for, row, seconds_to_good_data

EXAMPLE = SHARE / "systemd" / "80-can0.network"
NETWORK = Path("/etc/systemd/network/80-can0.network")
SUPPORT_CONFIG = Path("/etc/ramstroke/support.toml")
BUS_OFF = Path("/sys/module/can_bus_off/parameters/interface")
DRIVER = Path("/sys/bus/pci/drivers/kvaser_pci")
OTHER_BIT_RATE = "500000"


@pytest.fixture(scope="module", autouse=True)
def controllers() -> None:
    """The driver was loaded for the devices on the PCI bus; nobody has set them up."""
    run("modprobe", "can-bus-off")
    run("udevadm", "settle")
    install_service("can0")
    run("ip", "link", "set", "can1", "up", "type", "can", "bitrate", "250000")


@pytest.fixture(scope="module")
def running(controllers: None) -> Iterator[None]:
    """The service, which hears the support; one start for all tests."""
    load_devices()
    write_config(SUPPORT_CONFIG, "can1")
    start_support(SUPPORT_CONFIG)
    start_service()
    seconds_to_good_data(good_readings)
    yield
    assert properties("NRestarts", "ActiveState") == {"NRestarts": "0", "ActiveState": "active"}


@pytest.fixture
def journal(running: None) -> Iterator[Journal]:
    """From the beginning of the test on."""
    wait_for("a bus that is well", lambda: state_of("can") == "ok")
    seconds_to_good_data(good_readings)
    journal = Journal()
    yield journal
    journal.close()


def link() -> dict[str, Any]:
    """What `ip` shows of can0's controller."""
    (shown,) = json.loads(run("ip", "-details", "-statistics", "-json", "link", "show", "can0"))
    RESULTS.mkdir(exist_ok=True)
    with (RESULTS / "links.jsonl").open("a") as file:
        file.write(json.dumps(shown) + "\n")
    facts: dict[str, Any] = shown["linkinfo"]["info_data"]
    return facts | {"operstate": shown["operstate"], "events": shown["linkinfo"].get("info_xstats", {})}


def state() -> str:
    """Of the controller can0."""
    return str(link()["state"])


def set_can0(*words: str) -> None:
    """As a person would: an interface that is up does not change."""
    run("ip", "link", "set", "can0", "down")
    run("ip", "link", "set", "can0", "up", "type", "can", *words)


def doctor(name: str) -> dict[str, dict[str, Any]]:
    """Its checks of can0, kept for the report."""
    ended = subprocess.run([RAMSTROKE, "doctor", "--json"], capture_output=True, text=True, check=False)
    found = {check["name"]: check for check in json.loads(ended.stdout)["checks"]}
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"doctor-{name}.json").write_text(json.dumps(found, indent=2))
    return found


# --- setting it up: nothing of the service runs yet -------------------------------------------------------------


def test_doctor_tells_how_to_set_up_an_interface_without_a_bit_rate() -> None:
    interface = doctor("unset")["CAN interface"]
    assert interface["verdict"] == "fault"
    assert "can0 is down" in interface["found"]
    assert interface["advice"].startswith("sudo ip link set can0 up type can bitrate 250000 restart-ms 100")


def test_the_shipped_example_sets_it_up() -> None:
    NETWORK.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(EXAMPLE, NETWORK)
    run("systemctl", "enable", "--now", "systemd-networkd")
    wait_for("can0 that is up", lambda: state() == "ERROR-ACTIVE")
    facts = link()
    assert facts["bittiming"]["bitrate"] == 250_000
    assert facts["restart_ms"] == 100
    assert facts["ctrlmode"] == ["LISTEN-ONLY"]


def test_doctor_tells_that_a_listen_only_controller_cannot_publish() -> None:
    found = doctor("listen-only")
    assert found["CAN interface"]["found"] == "can0 is up, 250,000 bit/s"
    assert found["CAN controller"]["verdict"] == "fault"
    assert "listen-only" in found["CAN controller"]["found"]


def test_the_start_of_the_computer_is_not_held_up() -> None:
    """Even if systemd-networkd has no other interface."""
    run("/lib/systemd/systemd-networkd-wait-online", "--timeout=60")


def test_with_the_line_changed_as_it_says_it_may_send() -> None:
    NETWORK.write_text(EXAMPLE.read_text().replace("ListenOnly=yes", "ListenOnly=no"))
    run("networkctl", "reload")
    wait_for("can0 that sends", lambda: "ctrlmode" not in link() and state() == "ERROR-ACTIVE")
    facts = link()
    assert facts["bittiming"]["bitrate"] == 250_000
    assert facts["restart_ms"] == 100


# --- frames cross -----------------------------------------------------------------------------------------------


def test_frames_cross_the_controller_both_ways(running: None) -> None:
    database = cantools.database.load_file(SHARE / "config" / "dbc" / "ramstroke_estimate.dbc", database_format="dbc")
    assert isinstance(database, Database)
    lines = run("candump", "-L", "-n", "20", "-T", "60000", "can1,6F0:7FF").splitlines()
    decoded = []
    for line in lines:
        identifier, _, data = line.split()[2].partition("#")
        values = database.decode_message(int(identifier, 16), bytes.fromhex(data), decode_choices=False)
        assert isinstance(values, dict)
        decoded.append(values)
    counters = [int(str(values["counter"])) for values in decoded]
    assert len(counters) == 20
    assert counters == [(counters[0] + i) % 16 for i in range(20)]
    wait_for("parts that are well", lambda: {state_of("can"), state_of("displacement")} == {"ok"})
    bus = status()["can"]
    assert (bus["error_frames"], bus["send_failures"], bus["kernel_drops"]) == (0, 0, 0)


def test_doctor_finds_a_healthy_controller(running: None) -> None:
    found = doctor("healthy")
    assert found["CAN interface"]["found"] == "can0 is up, 250,000 bit/s"
    assert found["CAN interface"]["verdict"] == "ok"
    controller = found["CAN controller"]
    assert controller["verdict"] == "ok"
    assert controller["found"] == (
        "error-active, error counters transmit 0, receive 0, restart-ms 100, not listen-only"
    )
    assert found["CAN frames"]["verdict"] == "ok"
    assert found["displacement"]["verdict"] in ("ok", "warning")  # at rest it stands still
    assert "from the running daemon" in found["estimate identifier"]["found"]


# --- failures ---------------------------------------------------------------------------------------------------


def test_bus_off_with_a_restart_by_the_kernel(journal: Journal) -> None:
    restarts = link()["events"]["restarts"]
    BUS_OFF.write_text("can0")
    seconds = seconds_to_good_data(good_readings)
    journal.wait_for("bus-off")
    assert link()["events"]["restarts"] == restarts + 1
    assert state() == "ERROR-ACTIVE"
    assert status()["can"]["error_kinds"]["restarted"] >= 1
    row("can0 bus-off, restart-ms 100", journal, seconds)


def test_bus_off_until_it_is_restarted_by_hand(journal: Journal) -> None:
    set_can0("restart-ms", "0")
    seconds_to_good_data(good_readings)
    BUS_OFF.write_text("can0")
    facts = link()
    assert (facts["state"], facts["operstate"]) == ("BUS-OFF", "DOWN")
    said = journal.wait_for("can0 is bus-off")
    assert "ip link set can0 type can restart" in said
    assert "is bus-off" in status()["can"]["what"]
    assert no_good_data_for(5.0, good_readings)
    found = doctor("bus-off")
    assert found["CAN interface"]["verdict"] == "ok"
    controller = found["CAN controller"]
    assert controller["verdict"] == "fault"
    assert controller["found"].startswith("bus-off")
    assert "then sudo ip link set can0 type can restart;" in controller["advice"]
    assert "is bus-off" in found["daemon: can"]["found"]
    assert state() == "BUS-OFF"
    run("ip", "link", "set", "can0", "type", "can", "restart")
    row("can0 bus-off, restarted by hand", journal, seconds_to_good_data(good_readings))


def test_listen_only_while_the_estimate_is_to_be_published(journal: Journal) -> None:
    """The kernel takes the frames and drops them; displacements go on."""
    set_can0("listen-only", "on")
    journal.wait_for("is it listen-only?")
    assert run("candump", "-L", "-T", "3000", "can1,6F0:7FF") == ""
    seconds = seconds_to_good_data(good_readings)
    set_can0("listen-only", "off")
    assert len(run("candump", "-L", "-n", "5", "-T", "60000", "can1,6F0:7FF").splitlines()) == 5
    row("can0 listen-only, the estimate to be published", journal, seconds)


def test_the_bit_rate_is_changed(journal: Journal) -> None:
    """The support's interface follows; while an interface is up the kernel refuses."""
    run("ip", "link", "set", "can0", "type", "can", "bitrate", OTHER_BIT_RATE, code=2)
    run("ip", "link", "set", "can0", "down")
    journal.wait_for("can0 is down")
    interface = doctor("down")["CAN interface"]
    assert (interface["found"], interface["advice"]) == ("can0 is down", "sudo ip link set can0 up")
    run("ip", "link", "set", "can0", "up", "type", "can", "bitrate", OTHER_BIT_RATE, "restart-ms", "100")
    seconds = seconds_to_good_data(good_readings)
    facts = link()
    assert (facts["bittiming"]["bitrate"], facts["restart_ms"]) == (int(OTHER_BIT_RATE), 100)
    row("can0 down, another bit rate, up", journal, seconds)


def test_the_controller_is_taken_away_and_comes_back(journal: Journal) -> None:
    """systemd-networkd sets it up again, as the example says."""
    device = Path("/sys/class/net/can0/device").resolve().name
    (DRIVER / "unbind").write_text(device)
    journal.wait_for("there is no network interface can0")
    time.sleep(3.0)
    (DRIVER / "bind").write_text(device)
    seconds = seconds_to_good_data(good_readings, 2 * PATIENCE_S)
    assert link()["bittiming"]["bitrate"] == 250_000
    row("can0's controller taken away and put back", journal, seconds)
    wait_for("a bus that is well", lambda: state_of("can") == "ok")
