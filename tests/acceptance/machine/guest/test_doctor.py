"""`ramstroke doctor` on set-ups that are broken on the kernel's interfaces, one after the other.

Each has one fault, so that there must be one thing to mend, and it must be the right one.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.acceptance.machine.guest.doctor_kit import Seen, look
from tests.acceptance.machine.guest.kit import (
    CONFIG,
    RAMSTROKE,
    RECORDINGS,
    run,
    set_fault,
    set_up,
    start_service,
    status,
    wait_for,
)
from tests.acceptance.machine.guest.rows import good_readings, seconds_to_good_data

SPI = Path("/dev/spidev0.0")
SPIDEV = Path("/sys/bus/spi/drivers/spidev")
UNIT = Path("/etc/systemd/system/ramstroke.service")
DISK = Path("/dev/shm/recordings.ext4")


@pytest.fixture(scope="module", autouse=True)
def computer() -> None:
    """Healthy, with the service enabled and not running."""
    set_up()
    run("systemctl", "enable", "ramstroke")
    RECORDINGS.mkdir(parents=True)
    run("chown", "-R", "ramstroke:ramstroke", RECORDINGS.parent)


@contextmanager
def sensor_fault(words: str) -> Iterator[None]:
    set_fault(words)
    try:
        yield
    finally:
        set_fault("")


@contextmanager
def edited(path: Path, old: str, new: str) -> Iterator[None]:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    run("systemctl", "daemon-reload")
    try:
        yield
    finally:
        path.write_text(text)
        run("systemctl", "daemon-reload")


def the_one(seen: Seen) -> tuple[str, str]:
    """The only thing to mend."""
    assert seen.code == 1, seen.text
    assert len(seen.mend) == 1, seen.text
    return seen.mend[0]


def test_a_healthy_set_up_has_nothing_to_mend() -> None:
    seen = look("healthy")
    assert (seen.code, seen.mend) == (0, []), seen.text
    better = {name for name, _ in seen.better}
    # True of this machine: nobody sets its clock, its disk is small, its support shakes, no service runs.
    assert better <= {"time synchronisation", "free space", "noise at rest", "service"}


@pytest.mark.parametrize(
    ("fault", "check", "advice"),
    [
        ("open", "sensor", "MISO"),
        ("low", "sensor", "MISO"),
        ("product 0x4041", "sensor", "ADIS16448"),
        ("edges", "data-ready line", "DIO1"),
        ("silent", "SPI transfers", "dmesg"),
        ("error", "SPI transfers", "dmesg"),
    ],
)
def test_the_sensor_is_ill(fault: str, check: str, advice: str) -> None:
    with sensor_fault(fault):
        found = the_one(look(f"sensor, {fault}"))
    assert found[0] == check
    assert advice in found[1]


WRONG_FRAME = "[can.displacement]\narbitration_id = 0x320\n[can.publish]"


@pytest.mark.parametrize(
    ("old", "new", "check", "advice"),
    [
        ("data_ready_line = 0", "data_ready_line = 5", "data-ready line", "gpioinfo"),
        ("/dev/spidev0.0", "/dev/spidev1.0", "SPI port", "correct spi_device in [imu]"),
        (
            "[can.publish]",
            "[can.displacement]\narbitration_id = 0x320\n[can.publish]",
            "displacement",
            "arbitration_id",
        ),
        ('"vcan0"', '"vcan7"', "CAN interface", "correct channel in [can]"),
    ],
)
def test_the_configuration_does_not_fit(old: str, new: str, check: str, advice: str) -> None:
    with edited(CONFIG, old, new):
        found = the_one(look(f"configured {'another frame' if new == WRONG_FRAME else new}".replace("/", "_")))
    assert found[0] == check
    assert advice in found[1]


def test_a_configuration_with_an_unknown_key_is_told_in_one_sentence() -> None:
    with edited(CONFIG, "[imu]", "[imu]\nspi_port = 1"):
        seen = look_at_bad_configuration()
    assert seen.returncode == 2
    assert "spi_port" in seen.stderr
    assert seen.stderr.count("\n") == 1


def look_at_bad_configuration() -> subprocess.CompletedProcess[str]:
    return subprocess.run([RAMSTROKE, "doctor"], capture_output=True, text=True, check=False)


def test_the_spi_port_has_no_driver() -> None:
    (SPIDEV / "unbind").write_text("spi0.0")
    try:
        check, advice = the_one(look("no SPI port"))
    finally:
        (SPIDEV / "bind").write_text("spi0.0")
        run("udevadm", "settle")
    assert check == "SPI port"
    assert "switch SPI on" in advice


def test_who_asks_has_no_rights() -> None:
    """The service's rights count, and they are well; who may look further is told."""
    seen = look("asked by nobody", user="nobody")
    assert (seen.code, seen.mend) == (0, []), seen.text
    assert "for want of rights: sudo -u ramstroke ramstroke doctor" in seen.text


def test_the_services_user_has_no_rights() -> None:
    for group in ("spi", "gpio"):
        run("gpasswd", "--delete", "ramstroke", group)
    try:
        check, advice = the_one(look("service in no group"))
    finally:
        run("usermod", "-aG", "spi,gpio", "ramstroke")
    assert check == "SPI port"
    assert advice.startswith("sudo usermod -aG gpio,spi ramstroke")


def test_no_udev_rule_has_given_the_port_away() -> None:
    run("chown", "root:root", SPI)
    run("chmod", "600", SPI)
    try:
        check, advice = the_one(look("no udev rule"))
        assert check == "SPI port"
        assert "install-service" in advice
        run(RAMSTROKE, "install-service")
        assert SPI.group() == "spi"
    finally:
        run("chown", "root:spi", SPI)
        run("chmod", "660", SPI)


def test_the_bus_is_down() -> None:
    run("ip", "link", "set", "vcan0", "down")
    try:
        found = the_one(look("vcan0 down"))
    finally:
        run("ip", "link", "set", "vcan0", "up")
    assert found == ("CAN interface", "sudo ip link set vcan0 up")


def test_the_bus_is_silent() -> None:
    run("ip", "link", "add", "dev", "vcan1", "type", "vcan")
    run("ip", "link", "set", "vcan1", "up")
    with edited(CONFIG, '"vcan0"', '"vcan1"'):
        check, advice = the_one(look("silent bus"))
    assert check == "CAN frames"
    assert "start what sends on vcan1" in advice


def test_the_recording_disk_cannot_be_used() -> None:
    run("truncate", "--size=32M", DISK)
    run("mkfs.ext4", "-q", DISK)
    run("mount", "-o", "loop", DISK, RECORDINGS)
    try:
        check, advice = the_one(look("disk of another user"))
        assert check == "recording folder"
        assert advice.startswith("sudo install -d -o ramstroke")
        run("chown", "ramstroke:ramstroke", RECORDINGS)
        run("dd", "if=/dev/zero", f"of={RECORDINGS}/filler", "bs=64k", code=1)
        assert the_one(look("disk full"))[0] == "free space"
        (RECORDINGS / "filler").unlink()
        run("mount", "-o", "remount,ro", RECORDINGS)
        check, advice = the_one(look("disk read-only"))
        assert check == "recording folder"
        assert f"mount -o remount,rw {RECORDINGS}" in advice
    finally:
        run("umount", RECORDINGS)


def test_the_unit_was_changed_by_hand() -> None:
    with edited(UNIT, "WatchdogSec=10", "WatchdogSec=0"):
        seen = look("unit without watchdog")
    assert (seen.code, seen.mend) == (0, [])
    advice = dict(seen.better)
    assert "install-service" in advice["service's unit"]


def test_the_service_has_failed() -> None:
    with edited(CONFIG, "[imu]", "[imu]\nspi_port = 1"):
        run("systemctl", "start", "ramstroke", code=1)
    check, advice = the_one(look("service failed"))
    assert check == "service"
    assert "journalctl -u ramstroke" in advice
    run("systemctl", "reset-failed", "ramstroke")


def test_beside_a_running_daemon_what_it_feels_follows_from_what_is_seen() -> None:
    start_service()
    seconds_to_good_data()
    seconds_to_good_data(good_readings)
    assert look("service runs").mend == []
    run("ip", "link", "set", "vcan0", "down")
    wait_for("the daemon feels it", lambda: status()["can"]["state"] != "ok")
    try:
        found = the_one(look("service runs, vcan0 down"))
    finally:
        run("ip", "link", "set", "vcan0", "up")
    assert found == ("CAN interface", "sudo ip link set vcan0 up")
    with sensor_fault("open"):
        wait_for("the daemon feels it", lambda: status()["imu"]["state"] == "waiting")
        check, advice = the_one(look("service runs, sensor open"))
    assert check == "daemon: imu"
    assert "sensor is plugged in" in advice
