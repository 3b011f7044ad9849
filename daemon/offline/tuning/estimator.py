"""Process noises of our own estimator, tuned on recorded moves by its innovations or against the reference.

An evaluation is a run over all recordings; the run of a recording gives a score for each of its moves, so a search may
look at some of them and be judged by the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daemon.offline.parallel import parallel
from daemon.offline.replaying.replay import replay, settings_of
from daemon.offline.tuning.recordings import References
from daemon.recording import topics
from daemon.recording.errors import RecordingError
from daemon.recording.reader import Recording
from daemon.recording.topics import Recorded
from daemon.settings import Settings
from estimation.arrays import FloatArray
from estimation.displacement.sensor import GATE_SIGMAS
from estimation.records import CanState, Estimate
from estimation.tuning.local import from_point
from estimation.tuning.search import Found, Search, Spent
from estimation.tuning.two_state_tuning import Goal

BUDGET = 40  # runs over the recordings
DECADES = 1.5  # to either side of the configured value
STEP = 0.3  # decades, of the first simplex
PARAMETERS = ("speed_sigma_cycle", "speed_wander", "can_noise_mm")
LARGEST = (0.5, 0.5, 50.0)


@dataclass(frozen=True)
class MoveScores:
    """Of one recorded move under one set of noises."""

    readings: int
    deviance: float  # sum over the readings of e^2/S + ln S, in mm
    squares_mm2: float  # settled estimate against the reference at its readings; NaN without one
    references: int

    def of(self, goal: Goal) -> tuple[float, int]:
        """What the goal sums, and over how many."""
        return (self.deviance, self.readings) if goal == "ml" else (self.squares_mm2, self.references)


@dataclass(frozen=True)
class TunedEstimator:
    """The noises, and what they are worth on moves that they were not tuned on."""

    goal: Goal
    moves: int
    values: dict[str, float]
    before: dict[str, float]
    found: Found
    judged_before: float  # per reading, over all moves, each judged by noises tuned on the other half
    judged_after: float


def scores_of(path: Path, settings: Settings) -> list[MoveScores]:
    """Run one recording with these settings. Raises RecordingError as `replay`."""
    settled: list[Estimate] = []
    references = References()

    def sink(topic: str, record: Recorded) -> None:
        references.sink(topic, record)
        if topic == topics.SETTLED and isinstance(record, Estimate):
            settled.append(record)

    moves = replay(path, settings, sink).moves
    t_ns = np.array([one.t_ns for one in settled])
    p_m, innovation, gate = (
        np.array([getattr(one, name) for one in settled]) for name in ("displacement_m", "innovation_m", "gate_m")
    )
    trusted = np.array([one.can_state is CanState.OK for one in settled], dtype=bool)
    seen_ns = np.array([one.t_ns for one in references.readings])
    seen_m = np.array([one.value_m for one in references.readings])
    scores = []
    for move in moves:
        inside = (t_ns >= move.onset_ns) & (t_ns <= move.stop_ns) & trusted & np.isfinite(innovation)
        variance = (gate[inside] / GATE_SIGMAS) ** 2 * 1e6
        # What lies outside the gate is not used, and counts as much as what lies on it.
        nis = np.minimum((innovation[inside] * 1e3) ** 2 / variance, GATE_SIGMAS**2)
        judged = (seen_ns >= move.onset_ns) & (seen_ns <= move.stop_ns)
        off_mm = (np.interp(seen_ns[judged], t_ns, p_m) - seen_m[judged]) * 1e3
        squares = float((off_mm**2).sum()) if judged.any() else float("nan")
        scores.append(MoveScores(int(inside.sum()), float((nis + np.log(variance)).sum()), squares, int(judged.sum())))
    return scores


def tune_estimator(
    paths: Sequence[Path],
    settings: Settings | None,
    goal: Goal,
    budget: int = BUDGET,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> TunedEstimator:
    """Nelder-Mead over the logarithms of the noises from the configured values; each half of the moves judges the rest.

    Raises RecordingError where a recording has no move or, for the goal truth, no reference.
    """
    begun = {path: settings or settings_of(Recording(path)) for path in paths}
    before = {name: float(getattr(next(iter(begun.values())).estimator, name)) for name in PARAMETERS}
    middle = np.log10(list(before.values()))
    low, high = middle - DECADES, np.minimum(middle + DECADES, np.log10(LARGEST))
    known: dict[bytes, list[MoveScores]] = {}

    def scores(x: FloatArray) -> list[MoveScores]:
        if x.tobytes() not in known:
            noises = dict(zip(PARAMETERS, (10.0**x).tolist(), strict=True))
            cases = [(path, _with(of, noises)) for path, of in begun.items()]
            done = dict(parallel(_scored, cases, min(jobs, len(cases))))
            known[x.tobytes()] = [score for path in paths for score in done[path]]
            if progress is not None:
                progress(len(known))
        return known[x.tobytes()]

    moves = len(scores(middle))
    _check(scores(middle), goal, paths)

    def search(parts: Sequence[int]) -> Found:
        def value(candidates: FloatArray) -> FloatArray:
            told = [scores(x) for x in candidates]
            # Noises with which other moves are found are no candidates: their scores are of something else.
            return np.array([_mean(one, goal, parts) if len(one) == moves else np.inf for one in told])

        searched = Search(value, low, high, budget)
        with suppress(Spent):
            from_point(searched, middle, STEP)
        return searched.found()

    whole = search((0, 1))
    halves = (search((0,)), search((1,)))
    after = [_sum(scores(half.x), goal, (1 - part,)) for part, half in enumerate(halves)]
    return TunedEstimator(
        goal,
        moves,
        dict(zip(PARAMETERS, (10.0**whole.x).tolist(), strict=True)),
        before,
        whole,
        _mean(scores(middle), goal, (0, 1)),
        sum(total for total, _ in after) / sum(n for _, n in after),
    )


def _scored(case: tuple[Path, Settings]) -> tuple[Path, list[MoveScores]]:
    return case[0], scores_of(*case)


def _with(settings: Settings, noises: dict[str, float]) -> Settings:
    return settings.model_copy(update={"estimator": settings.estimator.model_copy(update=noises)})


def _sum(scores: Sequence[MoveScores], goal: Goal, parts: Sequence[int]) -> tuple[float, int]:
    """Over every second move, or all."""
    chosen = [score.of(goal) for number, score in enumerate(scores) if number % 2 in parts]
    return sum(total for total, _ in chosen), sum(n for _, n in chosen)


def _mean(scores: Sequence[MoveScores], goal: Goal, parts: Sequence[int]) -> float:
    total, n = _sum(scores, goal, parts)
    return total / n if n else float("inf")


def _check(scores: Sequence[MoveScores], goal: Goal, paths: Sequence[Path]) -> None:
    if len(scores) < 2:
        raise RecordingError(
            f"{', '.join(map(str, paths))}: {len(scores)} moves are too few: one is tuned on, another judges"
        )
    if any(score.of(goal)[1] == 0 for score in scores):
        what = "reading of the displacement" if goal == "ml" else "reading of a reference sensor"
        raise RecordingError(f"{', '.join(map(str, paths))}: a move without a {what} cannot be tuned on")
