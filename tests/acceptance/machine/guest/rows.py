"""The table of failures: what was done, what the journal said, and how long good data took to come back."""

from __future__ import annotations

import json
import time
from collections.abc import Callable

from tests.acceptance.machine.guest.kit import PATIENCE_S, RESULTS, Journal, run, status, wait_for

TABLE = RESULTS / "failures.jsonl"
_ENOUGH = 3  # good samples or readings; the first one may be a leftover


def good_samples() -> int:
    """What the estimator took of the inertial sensor; -1 while no daemon answers."""
    found = status().get("estimator")
    return int(found["samples"] - found["bad_samples"]) if found else -1


def good_readings() -> int:
    """Displacements that were taken from the bus; -1 while no daemon answers."""
    found = status().get("displacement")
    bad = ("malformed", "checksum", "repeated", "invalid", "out_of_range")
    return int(found["frames"] - sum(found[kind] for kind in bad)) if found else -1


def seconds_to_good_data(count: Callable[[], int] = good_samples, patience_s: float = PATIENCE_S) -> float:
    """Seconds of the machine until good data come again; a new daemon counts from zero."""
    start_s, last = time.monotonic(), count()

    def comes() -> bool:
        nonlocal last
        now = count()
        if last < 0 or now < last:
            last = now
        return last >= 0 and now >= last + _ENOUGH

    wait_for("good data", comes, patience_s)
    return time.monotonic() - start_s


def no_good_data_for(seconds: float, count: Callable[[], int] = good_samples) -> bool:
    """Whether none came in the next seconds."""
    before = count()
    time.sleep(seconds)
    return count() <= before + 1


def row(name: str, journal: Journal, seconds: float | None) -> None:
    """Keep what happened, for the report on the host, where it is seen also if a later test hangs."""
    said = [line.removeprefix("WARNING ").removeprefix("INFO ") for line in journal.lines()]
    RESULTS.mkdir(exist_ok=True)
    with TABLE.open("a") as table:
        table.write(json.dumps({"failure": name, "journal": said, "good_after_s": seconds}) + "\n")


def pid_of_service() -> int:
    """The daemon's process."""
    return int(run("systemctl", "show", "ramstroke", "--property=MainPID", "--value"))
