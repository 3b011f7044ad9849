"""The trial of docs/installation.md: the installed service with a virtual support, and the way back."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.acceptance.machine.guest.documented import documented
from tests.acceptance.machine.guest.kit import (
    CONFIG,
    RAMSTROKE,
    RESULTS,
    Journal,
    allow_slowness,
    properties,
    run,
    status,
    wait_for,
)

TRIAL = Path("/etc/ramstroke/trial.toml")
SOCKET = Path("/run/ramstroke-sim/imu.sock")
STATE = Path("/var/lib/ramstroke")
BEGIN = "sudo ramstroke install-service --trial --start"
END = "sudo ramstroke install-service --no-trial"
PUSH_S = 300.0


def state_of_support() -> str:
    return run("systemctl", "show", "ramstroke-sim", "--property=ActiveState", "--value").strip()


@pytest.fixture(scope="module")
def journal() -> Iterator[Journal]:
    """Installed as section 2 leaves it; the trial's copy of the configuration thins the samples for a slow machine."""
    run(RAMSTROKE, "install-service")
    allow_slowness()
    run(RAMSTROKE, "install-service", "--trial")
    text = TRIAL.read_text()
    assert "decimation_exponent = 0" in text
    TRIAL.write_text(text.replace("decimation_exponent = 0", "decimation_exponent = 5"))
    run(RAMSTROKE, "install-service", "--no-trial")
    followed = Journal()
    yield followed
    followed.close()


@pytest.fixture(scope="module")
def real_configuration(journal: Journal) -> bytes:
    return CONFIG.read_bytes()


def test_one_command_starts_service_and_support(journal: Journal, real_configuration: bytes) -> None:
    said = documented(BEGIN)
    assert "started" in said
    assert END in said
    assert properties("ActiveState", "UnitFileState") == {"ActiveState": "active", "UnitFileState": "enabled"}
    assert state_of_support() == "active"
    assert SOCKET.is_socket()
    journal.wait_for("ramstroke 0")
    journal.wait_for("inertial sensor: ")


def test_samples_and_displacement_come_and_a_push_is_confirmed(journal: Journal) -> None:
    wait_for("samples", lambda: status().get("estimator", {}).get("samples", 0) > 20)
    wait_for("displacement", lambda: status().get("displacement", {}).get("frames", 0) > 20)
    journal.wait_for("start confirmed (push)", PUSH_S)
    said = documented("sudo ramstroke status")
    (RESULTS / "status.txt").write_text(said)
    assert documented("candump -n 10 vcan0").count("vcan0") == 10
    lines = documented("sudo journalctl -u ramstroke -u ramstroke-sim -n 50")
    (RESULTS / "journal.txt").write_text(lines)
    assert "virtual support 1 on /run/ramstroke-sim/imu.sock" in run("journalctl", "--unit=ramstroke-sim")


def test_recordings_and_state_have_a_folder_of_their_own() -> None:
    wait_for("a state file", (STATE / "trial" / "state.json").exists)
    assert list((STATE / "trial" / "recordings").glob("*.mcap"))
    assert not (STATE / "state.json").exists()
    assert not (STATE / "recordings").exists()


def test_exposure_of_the_support_by_systemds_own_measure() -> None:
    said = run("systemd-analyze", "security", "--threshold=15", "ramstroke-sim.service")
    (RESULTS / "security.txt").write_text(said)
    assert "Overall exposure level for ramstroke-sim.service: 1." in said


def test_the_way_back_restores_the_real_configuration(journal: Journal, real_configuration: bytes) -> None:
    documented(END)
    assert state_of_support() == "inactive"
    assert not SOCKET.parent.exists()
    assert CONFIG.read_bytes() == real_configuration
    assert TRIAL.exists()
    assert properties("ActiveState", "UnitFileState") == {"ActiveState": "active", "UnitFileState": "enabled"}
    assert "/etc/ramstroke/ramstroke.toml" in properties("ExecStart")["ExecStart"]
    journal.wait_for("there is no SPI port /dev/spidev0.0")  # the real support's, which this machine has not


def test_both_stop_together() -> None:
    run(RAMSTROKE, "install-service", "--trial")
    assert state_of_support() == "active"
    run("systemctl", "stop", "ramstroke")  # returns when the daemon has ended
    wait_for("the support has ended", lambda: state_of_support() == "inactive")
    assert properties("Result") == {"Result": "success"}
