"""The command line as such: help, usage, exit codes, and never a traceback for what a person can mend."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import pytest

from daemon import cli
from daemon.cli import COMMANDS, SUMMARY, main
from daemon.errors import CommandError, UsageError
from daemon.recording.errors import RecordingError
from daemon.recording.metadata import program_version
from drivers.adis16448.device import ImuError
from drivers.can.settings import CanConfigError
from tests.conftest import DemoRun


def test_without_a_command_the_usage_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert capsys.readouterr().err.startswith("usage: ramstroke ")


def test_an_unknown_command_is_answered_with_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["measure"]) == 2
    said = capsys.readouterr().err
    assert "'measure'" in said
    assert all(name in said for name in COMMANDS)


def test_help_names_every_command_with_its_purpose(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert COMMANDS.keys() == SUMMARY.keys()
    for name, summary in SUMMARY.items():
        assert f"{name} {summary}" in said
    assert "Exit codes: 0 good, 1 the thing failed, 2 wrong usage or configuration." in said


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_ends_with_an_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--help"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"usage: ramstroke {command} ")
    assert f"\nExample:\n  ramstroke {command} " in said
    assert max(map(len, said.splitlines()[:-2])) <= 100


@pytest.mark.parametrize("command", COMMANDS)
def test_an_unknown_option_of_any_command_is_wrong_usage(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--frobnicate"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("usage: ramstroke ")


def test_the_version_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"ramstroke {program_version()}\n"


def command_that(error: BaseException) -> ModuleType:
    module = ModuleType("command")

    def run(_: object) -> int:
        raise error

    module.__dict__.update(HELP="", EXAMPLE="", configure=lambda parser: None, run=run)
    return module


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (CommandError("it failed: do this"), 1, "ramstroke: it failed: do this\n"),
        (UsageError("not like that"), 2, "ramstroke: not like that\n"),
        (RecordingError("x.mcap is empty"), 1, "ramstroke: x.mcap is empty\n"),
        (CanConfigError("no such signal"), 2, "ramstroke: no such signal\n"),
        (ImuError("no part"), 1, "ramstroke: no part\n"),
        (PermissionError(13, "Permission denied", "/a/b"), 1, "ramstroke: /a/b: Permission denied\n"),
        (OSError("cannot serve"), 1, "ramstroke: cannot serve\n"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
    ],
)
def test_what_a_person_can_mend_is_one_sentence(
    error: BaseException,
    code: int,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(cli, "_load", lambda _: command_that(error))
    assert main(["demo"]) == code
    assert capsys.readouterr() == ("", said)


def test_a_fault_of_the_program_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "_load", lambda _: command_that(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        main(["demo"])


UNREADABLE: dict[str, tuple[bytes | None, str]] = {
    "missing": (None, "does not exist"),
    "empty": (b"", "is empty"),
    "no recording": (b"t_s,gyro_x_rad_s\n", "is not an MCAP file"),
    "only the beginning of one": (b"\x89MCAP0\r\n", "ends before its first message"),
}


@pytest.mark.parametrize("what", UNREADABLE)
@pytest.mark.parametrize("command", [["replay"], ["review"], ["recover", "-o", "whole.mcap"]], ids=" ".join)
def test_a_file_that_cannot_be_read_is_told_in_one_sentence(
    what: str,
    command: Sequence[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    content, reason = UNREADABLE[what]
    if content is not None:
        Path("in.mcap").write_bytes(content)
    assert main([*command, "in.mcap", "--json"]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"ramstroke: in.mcap {reason}")
    assert printed.err.count("\n") == 1
    assert not Path("whole.mcap").exists()


def test_sim_serves_no_other_transport(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.toml"
    path.write_text('[imu]\ntransport = "virtual"\n')
    assert main(["sim", "--config", str(path)]) == 2
    assert capsys.readouterr().err == (f'ramstroke: {path}: sim serves imu.transport = "socket", not "virtual"\n')


def test_status_without_a_daemon_says_what_to_do(short_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = short_path / "x.toml"
    path.write_text(f'[service]\nsocket = "{short_path}/live.sock"\n')
    assert main(["status", "--config", str(path)]) == 1
    assert capsys.readouterr().err == (
        f"ramstroke: no daemon answers on {short_path}/live.sock (No such file or directory): "
        "start `ramstroke run`, or name its configuration with --config\n"
    )


@pytest.mark.parametrize(
    "arguments", [["--help"], ["check-config", "good.toml", "--json"], ["check-config", "good.toml"]]
)
def test_a_reader_that_has_gone_gets_no_traceback(arguments: list[str], tmp_path: Path) -> None:
    (tmp_path / "good.toml").write_text("")
    reading, writing = os.pipe()
    os.close(reading)
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    with os.fdopen(writing, "w") as nobody:
        ended = subprocess.run(
            [sys.executable, "-m", "daemon.cli", *arguments],
            stdout=nobody,
            stderr=subprocess.PIPE,
            env=environment,
            cwd=tmp_path,
            timeout=60,
            check=False,
        )
    assert (ended.returncode, ended.stderr) == (1, b"")


def test_json_goes_to_standard_output_alone(demo_run: DemoRun, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["recover", str(demo_run.recording), "-o", str(demo_run.folder.parent / "r.mcap"), "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out).keys() >= {"messages", "lost"}
    assert printed.err == ""
