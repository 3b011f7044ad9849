"""Installed, looked at by doctor, and shut in; `test_by_the_book.py` upgrades and removes."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from tests.acceptance.machine.guest.kit import (
    CONFIG,
    RAMSTROKE,
    RESULTS,
    add_bus,
    in_the_sandbox_of,
    install_service,
    load_devices,
    properties,
    run,
    start_support,
    status,
    wait_for,
)

STATE = Path("/var/lib/ramstroke")
ALLOWED = (
    *("own folder", "own run folder", "temporary folder", "recordings"),
    *("numpy", "unix socket", "can socket", "spi port", "gpio chip"),
)


@pytest.fixture(scope="module", autouse=True)
def computer() -> None:
    """With its devices, before anything is installed."""
    load_devices()
    add_bus()


def test_from_nothing_to_a_configuration_to_look_through() -> None:
    said = run(RAMSTROKE, "install-service")
    assert "wrote /etc/systemd/system/ramstroke.service" in said
    assert "look through /etc/ramstroke/ramstroke.toml" in said
    assert run(RAMSTROKE, "check-config", CONFIG).strip().endswith("good")
    assert set(run("id", "-Gn", "ramstroke").split()) >= {"ramstroke", "spi", "gpio", "dialout"}
    assert Path("/dev/spidev0.0").group() == "spi"
    assert Path("/dev/gpiochip0").group() == "gpio"
    assert run("/usr/local/bin/ramstroke", "--version").startswith("ramstroke ")
    assert properties("ActiveState") == {"ActiveState": "inactive"}
    CONFIG.unlink()


def test_doctor_finds_a_healthy_computer_before_the_service_starts() -> None:
    install_service()
    start_support()
    ended = subprocess.run([RAMSTROKE, "doctor", "--json"], capture_output=True, text=True, check=False)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "doctor.json").write_text(ended.stdout)
    found = {check["name"]: check for check in json.loads(ended.stdout)["checks"]}
    assert ended.returncode in (0, 1), ended.stderr  # an emulated machine is slow enough to be called ill
    for name in ("configuration", "sensor", "self-test", "data-ready line", "CAN interface", "recording folder"):
        assert found[name]["verdict"] == "ok", found[name]
    (RESULTS / "doctor.txt").write_text(run_any(RAMSTROKE, "doctor"))


def run_any(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


def test_it_starts_and_is_there_at_the_next_start() -> None:
    said = run(RAMSTROKE, "install-service", "--start")
    assert "started" in said
    assert properties("ActiveState", "UnitFileState") == {"ActiveState": "active", "UnitFileState": "enabled"}
    wait_for("samples", lambda: status().get("estimator", {}).get("samples", 0) > 20)


def test_each_line_of_the_journal_is_an_entry_with_fields() -> None:
    lines = run("journalctl", "--unit=ramstroke", "--output=json").splitlines()
    entries = [json.loads(line) for line in lines]
    own = [entry for entry in entries if entry.get("SYSLOG_IDENTIFIER") == "ramstroke"]
    assert any("ramstroke" in entry["MESSAGE"] and entry["PRIORITY"] == "6" for entry in own)
    assert all(entry["LOGGER"].split(".")[0] in ("daemon", "drivers", "asyncio", "can") for entry in own)


def test_the_sandbox_holds_and_lets_the_program_work() -> None:
    run("systemctl", "stop", "ramstroke")
    found = in_the_sandbox_of("ramstroke")
    assert {name: found[name] for name in ALLOWED} == dict.fromkeys(ALLOWED, "yes")
    assert [name for name, said in found.items() if said == "yes" and name not in ALLOWED] == []
    assert "somebody-elses" not in found["seen temporary files"]


def test_exposure_by_systemds_own_measure() -> None:
    said = run("systemd-analyze", "security", "--threshold=15", "ramstroke.service")
    (RESULTS / "security.txt").write_text(said)
    assert "Overall exposure level for ramstroke.service: 1." in said
