"""Recorded moves as problems for the tuners, and what the tuned values are worth on moves they were not tuned on."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from daemon.offline.replaying.replay import Progress, replay, settings_of
from daemon.recording.errors import RecordingError
from daemon.recording.reader import Recording
from daemon.recording.topics import Recorded, RecordedDisplacement
from daemon.settings import Settings
from estimation.arrays import FloatArray
from estimation.methods.batch import Batch, Collector, Span, levelled_at_rest
from estimation.methods.two_state import PAPER
from estimation.records import Displacement
from estimation.tuning.observed import Form, Observed, observed_by_readings
from estimation.tuning.two_state_tuning import Goal, Tuned, fit, tune

LEAD_S = 1.0  # of rest before a move: the filter starts from x = 0, P = 0
AFTER_S = 1.5  # of a stop


@dataclass(frozen=True)
class Motion:
    """One recorded move: where from, and what the two-state filter sees of it."""

    file: str
    number: int
    observed: Observed
    as_printed: Observed  # with q I, as paper A's Q and R are meant


@dataclass(frozen=True)
class Reported:
    """Root mean square error on moves not used for tuning [mm], of each way to choose Q and R."""

    moves: int
    by: dict[str, float]


@dataclass
class References:
    """Readings of a reference sensor in a recording, in order of time."""

    readings: list[Displacement] = field(default_factory=list)

    def sink(self, _topic: str, record: Recorded) -> None:
        """Take what a replay passes on."""
        if isinstance(record, RecordedDisplacement) and record.reading.is_reference and record.reading.valid:
            self.readings.append(record.reading)


def motions_of(
    path: Path, form: Form, settings: Settings | None = None, progress: Progress | None = None
) -> list[Motion]:
    """Every move of a recording that has enough readings. Raises RecordingError where there is none."""
    in_use = settings or settings_of(Recording(path))
    collector, references = Collector(in_use.mount, in_use.support), References()
    result = replay(path, settings, references.sink, progress, tap=collector.add)
    try:
        batch = collector.batch(result.moves)
    except ValueError as error:
        raise RecordingError(f"{path}: nothing can be tuned on it: {error}") from error
    if not len(batch.seen_s):
        raise RecordingError(f"{path}: no reading of the displacement is in it: Q and R of a filter need both sensors")
    reference = np.array(
        [((one.t_ns - batch.first_ns) * 1e-9, one.value_m) for one in references.readings], dtype=np.float64
    ).reshape(-1, 2)
    motions, why = [], "our estimator found no move in it"
    for number, span in enumerate(batch.moves, 1):
        try:
            as_printed = _observed(batch, span, reference, "qI")
            observed = as_printed if form == "qI" else _observed(batch, span, reference, form)
            motions.append(Motion(path.name, number, observed, as_printed))
        except ValueError as error:
            why = f"of move {number}, {error}"
    if not motions:
        raise RecordingError(f"{path}: nothing can be tuned on it: {why}")
    return motions


def _observed(batch: Batch, span: Span, reference: FloatArray, form: Form) -> Observed:
    """A move from shortly before its onset, in metres from the place where it began."""
    begin_s, end_s = span.onset_s - LEAD_S, span.stop_s + AFTER_S
    inside = (batch.t_s >= begin_s) & (batch.t_s <= end_s)
    seen = (batch.seen_s >= begin_s) & (batch.seen_s <= end_s)
    if not seen.any():
        raise ValueError("0 readings of the displacement are too few")
    before = seen & (batch.seen_s < span.onset_s)
    start_m = float(batch.seen_m[before].mean()) if before.any() else float(batch.seen_m[seen][0])
    truth = None
    if len(reference):
        truth = np.interp(batch.seen_s[seen], reference[:, 0], reference[:, 1])
        truth = truth - float(np.interp(span.onset_s - LEAD_S / 2, reference[:, 0], reference[:, 1]))
    a = levelled_at_rest(batch)[inside]
    return observed_by_readings(batch.t_s[inside], a, batch.seen_s[seen], batch.seen_m[seen] - start_m, truth, form)


def tuned_on_others(
    motions: Sequence[Motion], form: Form, method: str, goal: Goal, seed: int, budget: int
) -> Reported | None:
    """Tune on every second move, report on the rest, and the other way about; None without a truth or a second move."""
    observed = [motion.observed for motion in motions]
    if len(observed) < 2 or any(one.truth is None for one in observed):
        return None
    squares: dict[str, float] = {}
    readings = 0
    for part in (0, 1):
        train, judge = observed[part::2], observed[1 - part :: 2]
        readings += sum(len(one.y) for one in judge)
        ways = {
            "tuned": tune(train, form, method, goal, seed, budget),
            "tuned by the truth": tune(train, form, goal="truth"),
            "best possible": tune(judge, form, goal="truth"),
        }
        sums = {name: float(fit(judge, np.array([way.q / way.r])).squares[0]) for name, way in ways.items()}
        printed = [motion.as_printed for motion in motions[1 - part :: 2]]
        sums["Q, R of paper A"] = float(fit(printed, np.array([PAPER.q / PAPER.r])).squares[0])
        sums["readings alone"] = sum(float(((one.y - one.truth) ** 2).sum()) for one in judge if one.truth is not None)
        for name, total in sums.items():
            squares[name] = squares.get(name, 0.0) + total
    return Reported(len(observed), {name: float(np.sqrt(total / readings)) * 1e3 for name, total in squares.items()})


def fingerprint(paths: Sequence[Path]) -> str:
    """SHA-256 over the files, in their order."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def row_of(tuned: Tuned) -> dict[str, Any]:
    """For the table and the JSON output."""
    low, high = tuned.interval or (float("nan"),) * 2
    return {
        "method": tuned.method,
        "objective": tuned.goal,
        "form": tuned.form,
        "q": tuned.q,
        "r": tuned.r,
        "log10_ratio": tuned.log10_ratio,
        "log10_ratio_low": low,
        "log10_ratio_high": high,
        "determined": tuned.determined,
        "better_log10_ratio": tuned.better_log10_ratio,
        "value": tuned.value,
        "evaluations": tuned.evaluations,
        "whiteness_p": tuned.check.whiteness_p,
        "nis": tuned.check.nis,
        "nis_inside_95": tuned.check.nis_inside_95,
    }
