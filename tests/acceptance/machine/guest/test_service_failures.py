"""What a service meets in its life: devices that come late, disks, a hang, the clock, a bad configuration."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from tests.acceptance.machine.guest.kit import (
    CONFIG,
    RAMSTROKE,
    RECORDINGS,
    Journal,
    add_bus,
    install_service,
    load_devices,
    properties,
    run,
    start_service,
    start_support,
    state_of,
    status,
    wait_for,
)
from tests.acceptance.machine.guest.rows import good_readings, pid_of_service, row, seconds_to_good_data

DISK = Path("/dev/shm/recordings.ext4")
FILLER = RECORDINGS / "filler"


@pytest.fixture(scope="module", autouse=True)
def installed() -> None:
    """Recordings go to a small disk of their own, which the program may fill to the last byte."""
    install_service()
    CONFIG.write_text(CONFIG.read_text().replace("keep_free_mb = 20", "keep_free_mb = 0"))
    RECORDINGS.mkdir(parents=True)
    run("truncate", "--size=32M", DISK)
    run("mkfs.ext4", "-q", DISK)
    mount()
    run("chown", "-R", "ramstroke:ramstroke", RECORDINGS.parent)


def mount() -> None:
    run("mount", "-o", "loop,errors=remount-ro", DISK, RECORDINGS)


def test_devices_may_come_after_the_service(journal: Journal) -> None:
    start_service()
    journal.wait_for("there is no SPI port /dev/spidev0.0")
    journal.wait_for("there is no network interface vcan0")
    load_devices()
    add_bus()
    start_support()
    seconds = seconds_to_good_data()
    row("devices missing at the start", journal, max(seconds, seconds_to_good_data(good_readings)))


def test_a_full_disk_costs_the_recording_only(journal: Journal) -> None:
    wait_for("a recorder that is well", lambda: state_of("recorder") == "ok")
    run("dd", "if=/dev/zero", f"of={FILLER}", "bs=64k", code=1)  # to the last block
    journal.wait_for("No space left on device; check")
    seconds_to_good_data()
    FILLER.unlink()
    row("recording disk full", journal, _until_recorded())


def test_a_disk_that_turns_read_only_costs_the_recording_only(journal: Journal) -> None:
    wait_for("a recorder that is well", lambda: state_of("recorder") == "ok")
    # As after an error of the disk; `mount` refuses it while a file is open.
    (device,) = Path("/sys/fs/ext4").glob("loop*")
    (device / "trigger_fs_error").write_text("for the test")
    journal.wait_for("Read-only file system; check")
    seconds_to_good_data()
    # Another card in the slot.
    run("umount", RECORDINGS)
    mount()
    row("recording disk read-only", journal, _until_recorded())


def test_a_clock_set_back_does_no_harm(journal: Journal) -> None:
    run("date", "--set=-1 hour")
    seconds = max(seconds_to_good_data(), seconds_to_good_data(good_readings))
    assert state_of("imu") in ("ok", "ill")
    row("clock set back one hour", journal, seconds)
    wait_for("a bus that is well", lambda: state_of("can") == "ok")


def test_a_hang_is_ended_by_the_watchdog(journal: Journal) -> None:
    (newest,) = sorted(RECORDINGS.glob("*.mcap"), key=lambda path: path.stat().st_mtime)[-1:]
    old = pid_of_service()
    run("systemctl", "kill", "--signal=STOP", "ramstroke")
    journal.wait_for("Watchdog timeout")
    wait_for("another process", lambda: pid_of_service() not in (0, old))
    row("SIGSTOP", journal, seconds_to_good_data())
    assert properties("NRestarts") == {"NRestarts": "1"}
    replayed = json.loads(run(RAMSTROKE, "replay", newest, "--json"))
    assert replayed["identical"] is True


def test_a_bad_configuration_fails_once_with_its_sentence(journal: Journal) -> None:
    run("systemctl", "stop", "ramstroke")
    CONFIG.write_text(CONFIG.read_text().replace("[imu]", "[imu]\nspi_port = 1"))
    run("systemctl", "start", "ramstroke", code=1)
    line = journal.wait_for("spi_port")
    assert str(CONFIG) in line
    time.sleep(10.0)  # five times RestartSec
    found = properties("ActiveState", "Result", "ExecMainStatus", "NRestarts")
    assert found == {"ActiveState": "failed", "Result": "exit-code", "ExecMainStatus": "2", "NRestarts": "0"}
    row("bad configuration", journal, None)


def _until_recorded() -> float:
    """Seconds until the recorder is well again."""
    start_s = float(status()["t_s"])
    wait_for("a recorder that is well", lambda: state_of("recorder") == "ok")
    return float(status()["t_s"]) - start_s
