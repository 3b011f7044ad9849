"""Shared by all tests."""

from __future__ import annotations

import contextlib
import fcntl
import gc
import io
import json
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from daemon.cli import main


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--rebase", action="store_true", help="store what the regression recordings give now")


def pytest_collection_finish() -> None:
    """Thousands of collected tests stay to the end: the garbage collector need not look at them again and again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)


@dataclass(frozen=True)
class DemoRun:
    """One run of `ramstroke demo --seed 1 --json`."""

    folder: Path
    code: int
    report: dict[str, Any]

    @property
    def recording(self) -> Path:
        return self.folder / "demo.mcap"


@pytest.fixture(scope="session")
def demo_run(tmp_path_factory: pytest.TempPathFactory) -> DemoRun:
    """A whole push and retract, measured once for all tests; nobody changes the files."""
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "demo-run"
    shared.mkdir(exist_ok=True)
    folder, told = shared / "out", shared / "told.json"
    with (shared / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not told.exists():
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                code = main(["demo", "--seed", "1", "--json", "--out", str(folder)])
            told.write_text(json.dumps([code, printed.getvalue()]))
    code, answer = json.loads(told.read_text())
    return DemoRun(folder, code, json.loads(answer))


@pytest.fixture
def short_path() -> Iterator[Path]:
    """A folder for Unix sockets, whose paths must stay below 108 bytes."""
    folder = Path(tempfile.mkdtemp(prefix="rs-", dir="/tmp"))
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def unsettled_process() -> Iterator[None]:
    """The application sets up its process for ever; this one goes on with other tests."""
    threshold, interval, level = gc.get_threshold(), sys.getswitchinterval(), logging.getLogger().level
    logging.getLogger().setLevel(logging.INFO)
    yield
    gc.unfreeze()
    gc.collect()
    gc.freeze()
    gc.set_threshold(*threshold)
    sys.setswitchinterval(interval)
    logging.getLogger().setLevel(level)
