"""Acquisition in a thread against acquisition in a process, beside an event loop that is kept busy.

    python -m tests.lateness --minutes 10

Daemons of both kinds take turns, a minute each, so that both see the same computer. Nothing is asserted.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import multiprocessing
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from daemon.service.application import Application
from daemon.settings import Settings
from drivers.adis16448.counters import LATENESS_BINS_US

BUSY_S = REST_S = 0.010  # of the event loop
TURN_S = 60.0
SETTLE_S = 2.0  # start-up of the part does not count


def _settings(folder: Path, acquisition: str, priority: int | None) -> Settings:
    return Settings.model_validate(
        {
            "imu": {"transport": "virtual", "acquisition": acquisition, "realtime_priority": priority},
            "can": {"enabled": False},
            "recording": {"directory": str(folder / "recordings"), "keep_free_mb": 0},
            "service": {"socket": str(folder / "live"), "state_file": str(folder / "state.json")},
        }
    )


async def _keep_busy() -> None:
    while True:
        until = time.perf_counter() + BUSY_S
        while time.perf_counter() < until:
            pass
        await asyncio.sleep(REST_S)


async def _turn(settings: Settings, seconds: float) -> dict[str, Any]:
    running = Application(settings)
    task = asyncio.ensure_future(running.run())
    while not running.health()["imu"].get("samples"):
        await asyncio.sleep(0.1)
    busy = asyncio.ensure_future(_keep_busy())
    await asyncio.sleep(SETTLE_S)
    before = running.health()["imu"]
    await asyncio.sleep(seconds)
    after = running.health()["imu"]
    busy.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await busy
    running.stop()
    await task
    return {"before": before, "after": after}


def _in_a_process_of_its_own(acquisition: str, priority: int | None, seconds: float, answer: Any) -> None:
    with tempfile.TemporaryDirectory(prefix="rs-") as folder:
        answer.send(asyncio.run(_turn(_settings(Path(folder), acquisition, priority), seconds)))


def measure(acquisition: str, priority: int | None, seconds: float) -> dict[str, Any]:
    """Counters at the begin and the end of one turn."""
    context = multiprocessing.get_context("spawn")
    mine, theirs = context.Pipe()
    process = context.Process(target=_in_a_process_of_its_own, args=(acquisition, priority, seconds, theirs))
    process.start()
    counted: dict[str, Any] = mine.recv()
    process.join()
    return counted


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="for each kind")
    parser.add_argument("--priority", type=int, default=None, help="imu.realtime_priority of both")
    arguments = parser.parse_args()
    totals: dict[str, Counter[str]] = {"thread": Counter(), "process": Counter()}
    left_s = arguments.minutes * 60
    while left_s > 0:
        for acquisition, total in totals.items():
            counted = measure(acquisition, arguments.priority, min(TURN_S, left_s))
            for name in ("samples", "missed"):
                total[name] += counted["after"].get(name, 0) - counted["before"].get(name, 0)
            bins = [*(f"up to {us} us" for us in LATENESS_BINS_US), "later"]
            lateness = zip(bins, counted["after"]["lateness"], counted["before"]["lateness"], strict=True)
            for name, after, before in lateness:
                total[name] += after - before
            for kind, count in counted["after"].get("faults", {}).items():
                total[kind] += count - counted["before"].get("faults", {}).get(kind, 0)
        left_s -= TURN_S
        print(json.dumps(totals), flush=True)


if __name__ == "__main__":
    main()
