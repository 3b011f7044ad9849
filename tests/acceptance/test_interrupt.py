"""Ctrl-C at any moment: no half-written file, no traceback, exit code 130, nobody left behind."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from daemon.recording.reader import Recording
from daemon.recording.recover import recover
from tests.conftest import DemoRun

PATIENCE_S = 60.0
MOMENTS = 2
INTERRUPTED = 130
READY = "ready\n"
# The interpreter itself is up: what is interrupted from here on is ours.
PROGRAM = f"import sys; from daemon.cli import main; print({READY!r}, end='', flush=True); sys.exit(main())"


@dataclass(frozen=True)
class Ended:
    code: int
    seconds: float
    said: str
    out: Path


def run(arguments: list[str], folder: Path, after_s: float | None, presses: int = 1) -> Ended:
    """The command in a session of its own; Ctrl-C for all its processes `after_s` its beginning."""
    out = folder / "stdout.txt"
    with out.open("w") as stdout:
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            bufsize=1,
        )
        assert process.stdout is not None
        assert process.stdout.readline() == READY
        began_s = time.monotonic()
        if after_s is not None:
            time.sleep(after_s)
            for _ in range(presses):
                try:
                    os.killpg(process.pid, signal.SIGINT)
                except ProcessLookupError:
                    break
                time.sleep(0.02)
        told, said = process.communicate(timeout=4 * PATIENCE_S)
        stdout.write(told)
    seconds = time.monotonic() - began_s
    nobody_is_left(process.pid)
    return Ended(process.returncode, seconds, said, out)


def nobody_is_left(group: int) -> None:
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        assert time.monotonic() < until, "a process of the command goes on"
        time.sleep(0.05)


def whole(path: Path) -> bool:
    """By its kind, the file is all there."""
    data = path.read_bytes()
    if path.suffix == ".mcap":
        recording = Recording(path)
        return recording.complete and sum(1 for _ in recording.messages()) > 0 and not recording.damage
    if path.suffix == ".png":
        return data.endswith(b"IEND\xaeB`\x82")
    if path.suffix == ".csv":
        return data.endswith(b"\n") and len({row.count(b",") for row in data.splitlines()}) == 1
    if path.suffix == ".json":
        return bool(json.loads(data))
    raise AssertionError(f"{path} was not to be written")


Command = Callable[[Path, Path], list[str]]
COMMANDS: dict[str, Command] = {
    "demo": lambda out, _: ["demo", "--out", str(out / "demo")],
    "recover": lambda out, source: ["recover", str(source), "-o", str(out / "whole.mcap")],
    "replay": lambda out, source: [
        *("replay", str(source), "--csv", str(out / "steps.csv")),
        *("-o", str(out / "again.mcap"), "--save-state", str(out / "state.json")),
    ],
    "import": lambda out, source: ["import", str(source.with_name("table.csv")), "-o", str(out / "table.mcap")],
    "align": lambda out, source: ["align", str(source), "--latitude", "40", "--plot", str(out)],
    "tune": lambda out, source: ["tune", str(source), "--plot", str(out)],
    "evaluate": lambda out, _: [
        *("evaluate", "--scenario", "partial", "--no-can", "--seeds", "1:3", "--jobs", "2"),
        *("--json", "--plot", str(out)),
    ],
}


@pytest.fixture(scope="module")
def source(demo_run: DemoRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, and a table beside it."""
    folder = tmp_path_factory.mktemp("source")
    path = folder / "demo.mcap"
    cut = folder / "cut.mcap"
    data = demo_run.recording.read_bytes()
    cut.write_bytes(data[: len(data) * 65 // 100])  # up to behind the push
    recover(cut, path)
    row = ",0.001,0.002,0.003,0.1,0.2,9.8\n"
    head = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n"
    with (folder / "table.csv").open("w") as table:
        table.write(head)
        table.writelines(f"{number / 800}{row}" for number in range(30_000))
    return path


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.timeout(600)
def test_an_interrupt_at_any_moment_ends_a_command_in_order(name: str, source: Path, tmp_path: Path) -> None:
    first = tmp_path / "whole"
    first.mkdir()
    usual = run(COMMANDS[name](first, source), tmp_path, None)
    assert usual.code == 0, usual.said
    written = sorted(path.relative_to(first) for path in first.rglob("*") if path.is_file())
    assert all(whole(first / path) for path in written)
    dice = random.Random(name)
    codes: list[int] = []
    for moment in range(MOMENTS):
        out = tmp_path / f"at{moment}"
        out.mkdir()
        after_s = usual.seconds * (moment + dice.random()) / MOMENTS
        # Impatient people press twice.
        ended = run(COMMANDS[name](out, source), tmp_path, after_s, presses=1 + moment % 2)
        codes.append(ended.code)
        assert ended.code in (0, INTERRUPTED), f"after {after_s} s: {ended.said}"
        assert ended.said == ("interrupted\n" if ended.code else ""), f"after {after_s} s"
        told = ended.out.read_text()
        if ended.code == 0:  # too late
            assert sorted(path.relative_to(out) for path in out.rglob("*") if path.is_file()) == written
        elif "--json" in COMMANDS[name](out, source):
            assert told == "" or json.loads(told)
        for path in out.rglob("*"):
            if path.is_file():
                assert path.relative_to(out) in written, f"after {after_s} s: {path} is left"
                assert whole(path), f"after {after_s} s: {path} is not whole"
    assert codes.count(INTERRUPTED) >= MOMENTS // 2, codes


def test_an_interrupt_that_falls_into_a_finalizer_is_not_lost() -> None:
    program = """
import gc, os, signal, sys, time
import daemon.cli as cli

class Careless:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)

def work(arguments):
    thing = Careless()
    del thing
    time.sleep(30)
    return 0

cli._run = work
sys.exit(cli.main(["x"]))
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE_S)
    assert (ended.returncode, ended.stdout, ended.stderr) == (INTERRUPTED, "", "interrupted\n")


def test_a_command_that_was_told_to_ignore_interrupts_goes_on(tmp_path: Path) -> None:
    """As under nohup, or in the background of a script."""
    program = (
        "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); import daemon.cli as cli\n"
        "cli._run = lambda arguments: os.kill(os.getpid(), signal.SIGINT) or 7\n"
        "sys.exit(cli.main(['x']))"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE_S)
    assert (ended.returncode, ended.stderr) == (7, "")
