"""Reports of recordings, made on demand: one at a time, in a process of low priority, kept for the next who asks."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

KEPT = 8
WAITING = 8
LOWEST_PRIORITY = 19
TIMEOUT_S = 1800.0

Command = Callable[[Path, Path], list[str]]


def review_command(recording: Path, report: Path) -> list[str]:
    """`ramstroke review` of this installation."""
    return [sys.executable, "-m", "daemon.cli", "review", str(recording), "-o", str(report)]


@dataclass
class _Report:
    key: tuple[int, int]  # bytes and time of the recording's last change
    path: Path
    word: str = "waiting"  # building, ready, failed
    since_s: float = 0.0
    why: str = ""
    task: asyncio.Task[None] | None = None


class TooManyError(Exception):
    """As many reports wait as may."""


class Reports:
    """folder: for the finished reports. on_change: called when the state of any changes."""

    def __init__(self, folder: Path, on_change: Callable[[], object], command: Command = review_command) -> None:
        self._folder = folder
        self._on_change = on_change
        self._command = command
        self._reports: dict[str, _Report] = {}
        self._one_at_a_time = asyncio.Lock()

    def rows(self) -> dict[str, dict[str, Any]]:
        """State by name of the recording."""
        return {
            name: {"state": report.word, "since_s": report.since_s, "why": report.why}
            for name, report in self._reports.items()
        }

    def ask(self, recording: Path) -> str:
        """Have it made unless it is there or on its way; returns the state. Raises TooManyError, OSError."""
        found = recording.stat()
        key = (found.st_size, found.st_mtime_ns)
        report = self._reports.get(recording.name)
        if report is not None and (
            report.word in ("waiting", "building") or (report.word == "ready" and report.key == key)
        ):
            return report.word
        if sum(one.word in ("waiting", "building") for one in self._reports.values()) >= WAITING:
            raise TooManyError
        report = _Report(key, self._folder / f"{recording.name}.html")
        self._reports.pop(recording.name, None)
        self._reports[recording.name] = report
        self._become(report, "waiting")
        report.task = asyncio.ensure_future(self._make(recording, report))
        return report.word

    def ready(self, name: str) -> Path | None:
        """The finished report of the recording of that name."""
        report = self._reports.get(name)
        return report.path if report is not None and report.word == "ready" else None

    async def close(self) -> None:
        """Stop what is being made."""
        tasks = [report.task for report in self._reports.values() if report.task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _make(self, recording: Path, report: _Report) -> None:
        async with self._one_at_a_time:
            self._become(report, "building")
            unfinished = report.path.with_suffix(".part.html")
            try:
                why = await self._run(self._command(recording, unfinished))
                if not why and not unfinished.exists():
                    why = "no report was written"
                if not why:
                    unfinished.replace(report.path)
            except OSError as error:
                why = error.strerror or str(error)
            finally:
                unfinished.unlink(missing_ok=True)
        self._become(report, "failed" if why else "ready", why)
        self._forget_the_oldest()

    async def _run(self, command: list[str]) -> str:
        """Returns why it failed, in one sentence, or nothing."""
        process = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
            cwd=Path(__file__).parents[2],
        )
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, process.pid, LOWEST_PRIORITY)
        try:
            _, said = await asyncio.wait_for(process.communicate(), TIMEOUT_S)
        except TimeoutError:
            return f"it took longer than {TIMEOUT_S / 60:.0f} minutes"
        finally:
            if process.returncode is None:
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                await process.wait()
        if process.returncode == 0:
            return ""
        lines = said.decode(errors="replace").strip().splitlines() or [f"exit code {process.returncode}"]
        return re.sub(r"^ramstroke[^:]*: ", "", lines[-1])[:300]

    def _become(self, report: _Report, word: str, why: str = "") -> None:
        report.word, report.since_s, report.why = word, time.monotonic(), why
        self._on_change()

    def _forget_the_oldest(self) -> None:
        done = [name for name, report in self._reports.items() if report.word in ("ready", "failed")]
        for name in done[:-KEPT]:
            self._reports.pop(name).path.unlink(missing_ok=True)
