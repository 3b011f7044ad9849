"""All methods on the same virtual supports: what each costs in millimetres and millimetres a second."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from daemon.offline.evaluation.runs import pipeline_of, readings_of, records_of, virtual_support
from daemon.offline.evaluation.scenarios import SCENARIOS_OF_EVALUATION as SCENARIOS
from daemon.offline.evaluation.score import BRAKING_S, BURST_S, STANDS_S, Case
from daemon.offline.evaluation.summary import row_names, spread
from daemon.offline.parallel import parallel
from drivers.virtual.motion import TrueMove
from drivers.virtual.support import PlacedTrajectory
from estimation.arrays import FloatArray
from estimation.methods.batch import Batch, Collector, Course, Kind, span_of
from estimation.methods.registry import METHODS, OURS
from estimation.records import Displacement, Estimate, Move, Tier

OURS_INERTIAL = f"{OURS} without displacement sensor"


@dataclass(frozen=True)
class MethodScore:
    """One move by one method against the truth, before any stop is believed."""

    error_mm: float  # once the ram stands
    cvs_mean_speed_error_mm_s: float
    vvs_mse_mm2_s2: float  # mean squared error of the velocity: paper C, Table 5, as it can be read
    cvs_mse_mm2_s2: float


@dataclass(frozen=True)
class MethodResult:
    """One virtual support by one method; without scores the method gave up, `failure` says why."""

    scenario: str
    seed: int
    method: str
    failure: str
    scores: tuple[MethodScore, ...]


@dataclass(frozen=True)
class Played:
    """What all methods get of one virtual support, and the truth."""

    judged: PlacedTrajectory
    batch: Batch  # with the readings, and the moves found without them
    ours: dict[str, Course]


def play(scenario: str, seed: int) -> Played:
    """Run the support once, with and without the displacement sensor."""
    fused, inertial = Case(scenario, seed, "fused"), Case(scenario, seed, "inertial")
    support = virtual_support(fused)
    judged = support.placed(0)
    pipelines = {OURS: pipeline_of(fused), OURS_INERTIAL: pipeline_of(inertial)}
    outputs: dict[str, list[Estimate | Move]] = {name: [] for name in pipelines}
    collector = Collector()
    for record in records_of(support, readings_of(support, SCENARIOS[scenario], judged, fused=True)):
        collector.add(record)
        for name, pipeline in pipelines.items():
            if name == OURS or not isinstance(record, Displacement):
                outputs[name] += _kept(pipeline.feed(record))
    for name, pipeline in pipelines.items():
        outputs[name] += _kept(pipeline.finish())
    batch = collector.batch(_last_told(outputs[OURS_INERTIAL]))
    return Played(judged, batch, {name: _course(batch.first_ns, told) for name, told in outputs.items()})


def _kept(outputs: Iterable[Any]) -> list[Estimate | Move]:
    return [o for o in outputs if isinstance(o, Move) or (isinstance(o, Estimate) and o.tier is Tier.SETTLED)]


def _last_told(told: Sequence[Estimate | Move]) -> list[Move]:
    """Moves, a re-opened one as it was told last."""
    return list({move.number: move for move in told if isinstance(move, Move)}.values())


def _course(first_ns: int, told: Sequence[Estimate | Move]) -> Course:
    steps = [estimate for estimate in told if isinstance(estimate, Estimate)]
    moves = tuple(span_of(move, first_ns) for move in _last_told(told))
    return Course(
        np.array([step.displacement_m for step in steps]),
        np.array([step.velocity_m_s for step in steps]),
        np.array([step.acceleration_m_s2 for step in steps]),
        np.array([Kind[step.segment.name] for step in steps], dtype=np.int8),
        moves,
        t_s=np.array([(step.t_ns - first_ns) * 1e-9 for step in steps]),
    )


def evaluate_support(methods: Sequence[str], case: tuple[str, int]) -> list[MethodResult]:
    """Every method on one virtual support."""
    scenario, seed = case
    played = play(scenario, seed)
    results = []
    for name in methods:
        course_of = METHODS[name].course
        if course_of is None:
            results += [_judged(scenario, seed, label, played, course) for label, course in played.ours.items()]
            continue
        try:
            course = course_of(played.batch)
        except ValueError as error:
            results.append(MethodResult(scenario, seed, name, str(error), ()))
        else:
            results.append(_judged(scenario, seed, name, played, course))
    return results


def _judged(scenario: str, seed: int, name: str, played: Played, course: Course) -> MethodResult:
    truth = played.judged.trajectory.moves
    t_s = played.batch.t_s if course.t_s is None else course.t_s
    offset_s = played.batch.first_ns * 1e-9 - played.judged.start_s  # to the script's clock
    scores = tuple(_score(course, t_s + offset_s, played.judged, move) for move in truth)
    tolerance_s = SCENARIOS[scenario].time_tolerance_s
    wrong = len(course.moves) != len(truth) or any(
        abs(found.onset_s + offset_s - true.onset_s) > tolerance_s
        or abs(found.stop_s + offset_s - true.stop_s) > tolerance_s
        or found.direction * true.speed_m_s < 0
        for found, true in zip(course.moves, truth, strict=True)
    )
    return MethodResult(scenario, seed, name, "other moves than were made" if wrong else "", scores)


def _score(course: Course, t_s: FloatArray, judged: PlacedTrajectory, move: TrueMove) -> MethodScore:
    truth_s = judged.trajectory.t_s
    off_mm_s = (course.velocity_m_s - np.interp(t_s, truth_s, judged.trajectory.velocity_m_s)) * 1e3
    even = (t_s >= move.onset_s + BURST_S) & (t_s <= move.stop_s - BRAKING_S)
    varying = (t_s >= move.onset_s) & (t_s <= move.stop_s + STANDS_S) & ~even
    end_m = float(np.interp(move.stop_s + STANDS_S, t_s, course.displacement_m))
    return MethodScore(
        (end_m - move.end_m) * 1e3,
        float(off_mm_s[even].mean()),
        float(np.mean(off_mm_s[varying] ** 2)),
        float(np.mean(off_mm_s[even] ** 2)),
    )


def evaluate_methods(
    methods: Sequence[str],
    scenarios: Sequence[str],
    seeds: Sequence[int],
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> list[MethodResult]:
    """All methods on all supports; the same results whatever `jobs` is."""
    cases = [(scenario, seed) for scenario in scenarios for seed in seeds]
    done: dict[tuple[str, int], list[MethodResult]] = {}
    for results in parallel(partial(evaluate_support, tuple(methods)), cases, jobs):
        done[results[0].scenario, results[0].seed] = results
        if progress is not None:
            progress(len(done))
    return [result for case in cases for result in done[case]]


def summarise_methods(results: Sequence[MethodResult]) -> list[dict[str, Any]]:
    """A row for each scenario, move and method, over all records in which the method told anything."""
    rows = []
    for scenario in dict.fromkeys(result.scenario for result in results):
        of_scenario = [result for result in results if result.scenario == scenario]
        for index, move in enumerate(row_names(scenario)):
            for method in dict.fromkeys(result.method for result in of_scenario):
                told = [result for result in of_scenario if result.method == method]
                rows.append({"scenario": scenario, "move": move, "method": method} | _row(told, index))
    return rows


def _row(results: Sequence[MethodResult], index: int) -> dict[str, Any]:
    row: dict[str, Any] = {"records": len(results), "failures": sum(bool(result.failure) for result in results)}
    scores = [result.scores[index] for result in results if result.scores]
    if not scores:
        return row
    speed = np.abs([score.cvs_mean_speed_error_mm_s for score in scores])
    return row | {
        **spread(np.abs([score.error_mm for score in scores])),
        "cvs_speed_median_mm_s": float(np.median(speed)),
        "cvs_speed_p95_mm_s": float(np.percentile(speed, 95)),
        "cvs_speed_within_2_mm_s": float(np.mean(speed <= 2.0)),
        "vvs_mse_median_mm2_s2": float(np.median([score.vvs_mse_mm2_s2 for score in scores])),
        "cvs_mse_median_mm2_s2": float(np.median([score.cvs_mse_mm2_s2 for score in scores])),
    }
