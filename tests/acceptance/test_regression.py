"""Recorded bytes through the real program, compared with the stored outcome.

Each recording in `tests/data/regression` holds what sensor and bus delivered; beside it lies what the estimator made
of it, ten times a second. `make rebase` (or pytest --rebase) stores a new outcome: look at the difference before you
commit it. A user's recording becomes a test the same way: put it there (`ramstroke recover` makes it whole) and rebase.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from daemon.offline.replaying.replay import replay
from daemon.recording import topics
from daemon.recording.topics import Recorded
from estimation.records import Estimate, Event, Move

FOLDER = Path(__file__).parent.parent / "data" / "regression"
RECORDINGS = sorted(FOLDER.glob("*.mcap"))
EVERY = 10  # steps
# Other processors round elsewhere; a change of the estimator is far larger.
TOLERANCE_MM = 1e-4


def _outcome(recording: Path) -> str:
    """Moves and events in words, then one row for every tenth settled step."""
    told: list[str] = []
    settled: list[Estimate] = []

    def receive(_topic: str, record: Recorded) -> None:
        if isinstance(record, Event):
            told.append(f"event {record.t_ns * 1e-9:.3f} {record.what}")
        elif isinstance(record, Move):
            told.append(f"move {record.number} {record.kind} {record.onset_ns * 1e-9:.3f} {record.stop_ns * 1e-9:.3f}")
        elif _topic == topics.SETTLED and isinstance(record, Estimate):
            settled.append(record)

    replay(recording, sink=receive)
    text = io.StringIO()
    for line in told:
        text.write(f"# {line}\n")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["t_s", "displacement_mm", "sigma_mm", "segment", "can_state"])
    for e in settled[::EVERY]:
        rows.writerow(
            [f"{e.t_ns * 1e-9:.3f}", f"{e.displacement_m * 1e3:.4f}", f"{e.sigma_m * 1e3:.4f}", e.segment, e.can_state]
        )
    return text.getvalue()


def test_there_are_recordings() -> None:
    assert RECORDINGS


@pytest.mark.parametrize("recording", RECORDINGS, ids=lambda path: path.stem)
def test_outcome_is_the_stored_one(recording: Path, request: pytest.FixtureRequest) -> None:
    assert_same(_outcome(recording), recording.with_suffix(".csv"), request)


def assert_same(outcome: str, stored: Path, request: pytest.FixtureRequest) -> None:
    """Compare line by line with the stored outcome, or store it if asked to."""
    if request.config.getoption("--rebase"):
        stored.write_text(outcome)
    expected, got = stored.read_text().splitlines(), outcome.splitlines()
    for number, (old, new) in enumerate(zip(expected, got, strict=False), start=1):
        assert _same(old, new), f"{stored.name}:{number}: first difference: stored {old!r}, now {new!r}"
    assert len(got) == len(expected)


def _same(old: str, new: str) -> bool:
    if old == new:
        return True
    if old.startswith("#"):
        return False
    before, after = old.split(","), new.split(",")
    if before[0] != after[0] or before[3:] != after[3:]:
        return False
    return all(abs(float(a) - float(b)) <= TOLERANCE_MM for a, b in zip(before[1:3], after[1:3], strict=True))
