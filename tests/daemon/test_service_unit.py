"""The unit of systemd fits the program: where it writes, what it tells systemd, and when it is started again."""

from __future__ import annotations

import configparser
import shlex
from pathlib import Path

import pytest

from daemon import cli
from daemon.configuration import load
from daemon.errors import FAILED, MISUSED
from daemon.settings import Settings

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def unit() -> configparser.ConfigParser:
    return read("ramstroke.service")


def read(name: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(strict=False, interpolation=None, delimiters=("=",))
    parser.optionxform = str  # type: ignore[assignment,method-assign]  # systemd minds the case
    assert parser.read(ROOT / "systemd" / name) != []
    return parser


def test_the_support_of_a_trial_comes_and_goes_with_the_daemon() -> None:
    drop_in, support = (read(name) for name in ("ramstroke-trial.conf", "ramstroke-sim.service"))
    assert drop_in["Unit"]["Wants"] == "ramstroke-sim.service"
    assert support["Unit"]["PartOf"] == support["Unit"]["Before"] == "ramstroke.service"
    configuration = support["Service"]["ExecStart"].split("--config ")[1]
    assert drop_in["Service"]["ExecStart"].endswith(f"ramstroke run --config {configuration}")
    socket = load(ROOT / "config" / "trial_service.toml").imu.socket_path
    assert Path(socket).parent == Path("/run") / support["Service"]["RuntimeDirectory"]


def test_a_failed_run_is_started_again_within_limits(unit: configparser.ConfigParser) -> None:
    burst, interval_s = int(unit["Unit"]["StartLimitBurst"]), int(unit["Unit"]["StartLimitIntervalSec"])
    pause_s = int(unit["Service"]["RestartSec"])
    assert unit["Service"]["Restart"] == "on-failure"
    assert 0 < burst * pause_s < interval_s, "a program that fails at once must reach the limit"


def test_a_switched_off_support_does_not_end_the_service(unit: configparser.ConfigParser) -> None:
    burst, interval_s = int(unit["Unit"]["StartLimitBurst"]), int(unit["Unit"]["StartLimitIntervalSec"])
    from_watchdog_to_watchdog_s = int(unit["Service"]["WatchdogSec"]) + int(unit["Service"]["RestartSec"])
    assert burst * from_watchdog_to_watchdog_s > interval_s


def test_a_bad_configuration_is_not_started_again_but_another_failure_is(
    unit: configparser.ConfigParser, tmp_path: Path
) -> None:
    final = {int(code) for code in unit["Service"]["RestartPreventExitStatus"].split()}
    assert final == {MISUSED}
    assert FAILED not in final
    broken = tmp_path / "broken.toml"
    broken.write_text("[imu]\nspi_port = 1\n")
    _, command, *options = shlex.split(unit["Service"]["ExecStart"])
    assert cli.main([command, *options[:-1], str(broken)]) in final


def test_it_starts_the_daemon_with_the_installed_configuration(unit: configparser.ConfigParser) -> None:
    assert unit["Service"]["ExecStart"].split() == [
        "/opt/ramstroke/bin/ramstroke",
        "run",
        "--config",
        "/etc/ramstroke/ramstroke.toml",
    ]
    assert unit["Service"]["User"] == "ramstroke"


def test_the_program_reports_readiness_and_signs_of_life(unit: configparser.ConfigParser) -> None:
    assert unit["Service"]["Type"] == "notify"
    assert int(unit["Service"]["WatchdogSec"]) == 10


def test_the_default_paths_lie_in_the_folders_that_systemd_makes(unit: configparser.ConfigParser) -> None:
    runtime = Path("/run") / unit["Service"]["RuntimeDirectory"]
    state = Path("/var/lib") / unit["Service"]["StateDirectory"]
    settings = Settings()
    assert settings.service.socket.is_relative_to(runtime)
    assert settings.service.state_file.is_relative_to(state)
    assert settings.recording.directory.is_relative_to(state)
