"""`ramstroke doctor` on set-ups that are broken on the kernel's interfaces, one after the other."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.acceptance.machine.guest.doctor_kit import CHANGED, Seen, changed, look
from tests.acceptance.machine.guest.kit import (
    CONFIG,
    RECORDINGS,
    properties,
    run,
    set_fault,
    set_up,
    start_service,
    status,
    wait_for,
)
from tests.acceptance.machine.guest.rows import good_readings, seconds_to_good_data

SPI, CHIP = Path("/dev/spidev0.0"), Path("/dev/gpiochip0")
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
def fault(words: str) -> Iterator[None]:
    set_fault(words)
    try:
        yield
    finally:
        set_fault("")


def test_healthy() -> None:
    seen = look("healthy")
    print(seen.text)


@pytest.mark.parametrize("words", ["open", "low", "product 0x4041", "edges", "silent", "error"])
def test_fault(words) -> None:
    with fault(words):
        seen = look("sensor: " + words)
    print(seen.text)


@pytest.mark.parametrize("old,new", [
 ("data_ready_line = 0", "data_ready_line = 5"),
 ("/dev/gpiochip0", "/dev/gpiochip7"),
 ("/dev/spidev0.0", "/dev/spidev1.0"),
 ("[can.publish]", "[can.displacement]\narbitration_id = 0x320\n[can.publish]"),
 ('"vcan0"', '"vcan7"'),
])
def test_config(old, new) -> None:
    with changed(old, new):
        seen = look("config: " + new)
    print(seen.text)


def test_node() -> None:
    (SPIDEV / "unbind").write_text("spi0.0")
    try:
        seen = look("node missing")
    finally:
        (SPIDEV / "bind").write_text("spi0.0")
        run("udevadm", "settle")
    print(seen.text)


def test_busy() -> None:
    with subprocess.Popen(["sh", "-c", f"exec 3<>{SPI}; exec sleep 1000"]) as other:
        try:
            seen = look("busy")
        finally:
            other.kill()
    print(seen.text)


def test_nobody_with_unit() -> None:
    print(look("nobody, unit", user="nobody").text)


def test_nobody_without_unit() -> None:
    UNIT.rename("/tmp/unit")
    run("systemctl", "daemon-reload")
    try:
        seen = look("nobody, no unit", user="nobody")
    finally:
        run("mv", "/tmp/unit", UNIT)
        run("systemctl", "daemon-reload")
    print(seen.text)


def test_group() -> None:
    run("gpasswd", "-d", "ramstroke", "spi")
    run("gpasswd", "-d", "ramstroke", "gpio")
    try:
        seen = look("not in groups")
    finally:
        run("usermod", "-aG", "spi,gpio", "ramstroke")
    print(seen.text)


def test_rule() -> None:
    run("chown", "root:root", SPI)
    run("chmod", "600", SPI)
    try:
        seen = look("no udev rule")
    finally:
        run("chown", "root:spi", SPI)
        run("chmod", "660", SPI)
    print(seen.text)


def test_down() -> None:
    run("ip", "link", "set", "vcan0", "down")
    try:
        seen = look("vcan0 down")
    finally:
        run("ip", "link", "set", "vcan0", "up")
    print(seen.text)


def test_silent_bus() -> None:
    run("ip", "link", "add", "dev", "vcan1", "type", "vcan")
    run("ip", "link", "set", "vcan1", "up")
    with changed('"vcan0"', '"vcan1"'):
        print(look("bus silent").text)


def test_disk() -> None:
    run("truncate", "--size=32M", DISK)
    run("mkfs.ext4", "-q", DISK)
    run("mount", "-o", "loop", DISK, RECORDINGS)
    try:
        print(look("not the service's folder").text)
        run("chown", "ramstroke:ramstroke", RECORDINGS)
        run("dd", "if=/dev/zero", f"of={RECORDINGS}/filler", "bs=64k", code=1)
        print(look("disk full").text)
        (RECORDINGS / "filler").unlink()
        run("mount", "-o", "remount,ro", RECORDINGS)
        print(look("read-only").text)
    finally:
        run("umount", RECORDINGS)


def test_unknown_key() -> None:
    with changed("[imu]", "[imu]\nspi_port = 1"):
        print(look("unknown key").text)


def test_unit() -> None:
    text = UNIT.read_text()
    UNIT.write_text(text.replace("WatchdogSec=10", "WatchdogSec=0"))
    run("systemctl", "daemon-reload")
    try:
        print(look("unit changed").text)
    finally:
        UNIT.write_text(text)
        run("systemctl", "daemon-reload")


def test_failed() -> None:
    with changed("[imu]", "[imu]\nspi_port = 1"):
        run("systemctl", "start", "ramstroke", code=1)
    print(look("service failed").text)
    run("systemctl", "reset-failed", "ramstroke")


def test_running() -> None:
    start_service()
    seconds_to_good_data()
    print(look("running").text)
    print(look("running, asked by nobody", user="nobody").text)
    run("ip", "link", "set", "vcan0", "down")
    wait_for("told", lambda: status()["can"]["state"] != "ok")
    print(look("running, vcan0 down").text)
    run("ip", "link", "set", "vcan0", "up")
    with fault("open"):
        wait_for("told", lambda: status()["imu"]["state"] == "waiting")
        print(look("running, open").text)
    run("systemctl", "stop", "ramstroke")
    with changed('"vcan0"', '"vcan1"'):
        start_service()
        seconds_to_good_data()
        print(look("running, bus silent").text)
