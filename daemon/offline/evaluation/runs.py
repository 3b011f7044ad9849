"""Accuracy by Monte Carlo: the estimator on many virtual supports, beside the clock, truth known.

The sensor is computed in arrays here instead of being read over SPI word by word; filters, quantisation and
everything behind the driver are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import dropwhile, takewhile
from math import nan

import numpy as np
from numpy.typing import NDArray

from daemon.offline.evaluation.scenarios import SCENARIOS_OF_EVALUATION as SCENARIOS
from daemon.offline.evaluation.scenarios import EvaluationScenario
from daemon.offline.evaluation.score import Case, MoveScore, Run, SeedResult, clock_error_mm, failure_of
from daemon.offline.parallel import parallel
from drivers.adis16448.registers import ACCEL_LSB, GYRO_LSB_DPS
from drivers.virtual.adis16448_signal import HISTORY, FilterPath
from drivers.virtual.controller import Observation
from drivers.virtual.motion import RATE_HZ
from drivers.virtual.support import PlacedTrajectory, VirtualSupport
from estimation.pipeline import Pipeline, Start
from estimation.records import Displacement, ImuSample, Move, Output, Record
from estimation.settings import MountSettings
from estimation.smoothing.settled_smoother import SettledSmoother, SmoothedStep

FILTER_TAPS_EXPONENT, GYRO_RANGE_DPS = 2, 500  # the driver's defaults


def records_of(support: VirtualSupport, readings: Iterable[Observation]) -> Iterator[Record]:
    """What driver and bus would hand over of that support's run, in order of time."""
    path: FilterPath | None = None
    inertial = support.inertial_input()
    readings = iter(readings)
    reading = next(readings, None)
    gyro_lsb = np.radians(GYRO_LSB_DPS[GYRO_RANGE_DPS])
    lsb = np.array([gyro_lsb] * 3 + [ACCEL_LSB] * 3)
    while (block := inertial.block()) is not None:
        gyro, accel = support.sensor_errors.apply(
            1 / support.sample_rate_hz, block.gyro, block.accel, block.temperature_c
        )
        samples = np.column_stack([gyro, accel, block.temperature_c])
        if path is None:
            path = FilterPath(FILTER_TAPS_EXPONENT, 0, np.tile(samples[0], (HISTORY, 1)))
        _, filtered = path.feed(samples)
        values: NDArray[np.float64] = np.rint(filtered[:, :6] / lsb) * lsb
        for t_ns, (gx, gy, gz, ax, ay, az) in zip(block.t_ns.tolist(), values.tolist(), strict=True):
            while reading is not None and reading[0] <= t_ns:
                yield Displacement(reading[0], reading[1])
                reading = next(readings, None)
            yield ImuSample(t_ns, (gx, gy, gz), (ax, ay, az))


def readings_of(
    support: VirtualSupport, scenario: EvaluationScenario, judged: PlacedTrajectory, *, fused: bool
) -> Iterator[Observation]:
    """What the displacement sensor says, after the scenario has had its way with it."""
    moves = judged.trajectory.moves
    first_onset_s = judged.start_s + (moves[0].onset_s if moves else 0.0)
    tampering = None if scenario.tampering is None else scenario.tampering()
    for t_ns, value_m in support.observations():
        t_s = (t_ns - support.start_ns) * 1e-9
        if t_s >= judged.start_s and not fused:
            return
        told_m = value_m if tampering is None else tampering(t_s - first_onset_s, value_m)
        if told_m is not None:
            yield t_ns, told_m


def virtual_support(case: Case) -> VirtualSupport:
    """The support of a case."""
    scenario = SCENARIOS[case.scenario]
    turn = np.radians(scenario.turned_deg)
    return VirtualSupport(
        case.seed,
        scenario.world.support,
        displacement_sensor=scenario.world.sensor,
        cycles=1,
        script=scenario.script,
        warm_up=case.warm_up,
        clock_error=scenario.clock_error,
        sensor_axes=np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]]),
    )


def evaluate_case(case: Case, warmed_up: bytes | None = None) -> SeedResult:
    """Play the support, estimate, compare; `warmed_up`: the pipeline's snapshot after the warm-up, if it is known."""
    scenario, support = SCENARIOS[case.scenario], virtual_support(case)
    judged = support.placed(case.warm_up)
    records = records_of(support, readings_of(support, scenario, judged, fused=case.mode == "fused"))
    pipeline = pipeline_of(case)
    if case.warm_up:
        pipeline.restore(_warm_up(case) if warmed_up is None else warmed_up)
        records = dropwhile(lambda record: not _is_judged(record, judged), records)
    steps: list[SmoothedStep] = []
    smoother = SettledSmoother(pipeline, steps.append)
    outputs: list[Output] = []
    told_s: dict[int, float] = {}
    for record in records:
        for out in pipeline.feed(record):
            outputs.append(out)
            if isinstance(out, Move):
                told_s[out.number] = record.t_ns * 1e-9
    outputs += pipeline.finish()
    smoother.finish()

    run = Run(support, case.warm_up, outputs, steps)
    found = {out.number: out for out in outputs if isinstance(out, Move) and out.stop_ns * 1e-9 > judged.start_s}
    truth = judged.trajectory.moves
    rng = np.random.default_rng([case.seed, 95])
    scores: list[MoveScore | None] = []
    for true in truth:
        move, instant = run.summary_of(true, found.values()), rng.uniform()
        told = nan if move is None else told_s.get(move.number, nan)
        can_be_told = move is not None or scenario.felt(true) or case.mode == "fused"
        scores.append(run.score(move, true, instant, told) if can_be_told else None)
    rest_s, false_moves = 0.0, 0
    if scenario.only_rest:
        rest_s = truth[0].onset_s
        ends_ns = (judged.start_s + rest_s - scenario.time_tolerance_s) * 1e9
        false_moves = sum(move.onset_ns < ends_ns for move in found.values())
    failure = failure_of(run, list(found.values()), truth, scores, scenario)
    return SeedResult(case, failure, scores, [clock_error_mm(true) for true in truth], rest_s, false_moves)


def pipeline_of(case: Case) -> Pipeline:
    """Our estimator as it begins with a case."""
    return Pipeline(mount=MountSettings(imu_on=SCENARIOS[case.scenario].imu_on), start=Start(0.0))


def _is_judged(record: Record, judged: PlacedTrajectory) -> bool:
    # A sample between the last cycle's end and this one's start is of this one.
    return record.t_ns * 1e-9 > judged.start_s - 1 / RATE_HZ


def _warm_up(case: Case) -> bytes:
    """What the pipeline is after the warm-up, which has the displacement sensor in its plain state."""
    support, pipeline = virtual_support(case), pipeline_of(case)
    judged = support.placed(case.warm_up)
    for record in takewhile(lambda record: not _is_judged(record, judged), records_of(support, support.observations())):
        pipeline.feed(record)
    return pipeline.snapshot()


def evaluate(cases: Sequence[Case], jobs: int = 1, progress: Callable[[int], None] | None = None) -> list[SeedResult]:
    """All cases, in their order; the same results whatever `jobs` is."""
    done: dict[Case, SeedResult] = {}
    for results in parallel(_evaluate_group, _with_one_warm_up(cases), jobs):
        done |= {result.case: result for result in results}
        if progress is not None:
            progress(len(done))
    return [done[case] for case in cases]


def _with_one_warm_up(cases: Sequence[Case]) -> list[list[Case]]:
    """Cases whose support does the same before it is judged, together; without a warm-up each alone."""
    groups: dict[Hashable, list[Case]] = {}
    for case in cases:
        key = replace(SCENARIOS[case.scenario], about="", script=(), tampering=None), case.seed, case.warm_up
        groups.setdefault(key if case.warm_up else case, []).append(case)
    return list(groups.values())


def _evaluate_group(cases: Sequence[Case]) -> list[SeedResult]:
    warmed_up = _warm_up(cases[0]) if cases[0].warm_up else None
    return [evaluate_case(case, warmed_up) for case in cases]
