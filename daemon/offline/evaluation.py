"""Accuracy by Monte Carlo: the estimator on many virtual supports, beside the clock, truth known.

The sensor is computed in arrays here instead of being read over SPI word by word; filters, quantisation and
everything behind the driver are the same.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.adis16448.registers import ACCEL_LSB, GYRO_LSB_DPS
from drivers.virtual.adis16448_signal import HISTORY, FilterPath
from drivers.virtual.motion import TrueMove
from drivers.virtual.scenarios import SCENARIOS
from drivers.virtual.support import VirtualSupport
from estimation.pipeline import Pipeline, Start
from estimation.records import Displacement, ImuSample, Move, MoveKind, Record
from estimation.settings import SupportSettings
from estimation.settled_smoother import SettledSmoother, SmoothedStep

FILTER_TAPS_EXPONENT, GYRO_RANGE_DPS = 2, 500  # the driver's defaults
TIME_TOLERANCE_S = 0.3  # an onset or stop farther off is a failure
CATASTROPHE_M = 0.05
SIGMAS_95 = 1.96
MODES = ("fused", "inertial")


@dataclass(frozen=True)
class MoveScore:
    """One move against the truth."""

    kind: str
    error_mm: float  # before any mechanical-stop constraint
    sigma_mm: float
    error_after_stop_mm: float
    rmse_mm: float  # settled tier, over the move
    smoothed_rmse_mm: float
    smoothed_inside_95: float  # share of the move's steps within the stated 95 %
    onset_error_ms: float
    stop_error_ms: float


@dataclass(frozen=True)
class SeedResult:
    """One virtual support, one mode."""

    seed: int
    mode: str
    failure: str = ""  # why the record counts as failed; empty = every move right
    moves: list[MoveScore] = field(default_factory=list)
    clock_errors_mm: list[float] = field(default_factory=list)  # nominal speed x true time, per move


def records_of(support: VirtualSupport, *, fused: bool) -> Iterator[Record]:
    """What driver and bus would hand over of that support's run, in order of time."""
    path: FilterPath | None = None
    inertial = support.inertial_input()
    readings = iter(support.observations()) if fused else iter(())
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


def evaluate_seed(seed: int, scenario: str, mode: str) -> SeedResult:
    """First cycle of one machine, nothing learned before."""
    support = VirtualSupport(seed, SCENARIOS[scenario], cycles=1)
    pipeline = Pipeline(start=Start(0.0))
    steps: list[SmoothedStep] = []
    smoother = SettledSmoother(pipeline, steps.append)
    outputs = [out for record in records_of(support, fused=mode == "fused") for out in pipeline.feed(record)]
    outputs += pipeline.finish()
    smoother.finish()
    moves: dict[int, Move] = {out.number: out for out in outputs if isinstance(out, Move)}

    truth = support.truth()
    t_s = np.array([step.settled.t_ns for step in steps]) * 1e-9
    true_m = np.interp(t_s, truth.t_s, truth.displacement_m)
    deviation_m = np.array([step.settled.displacement_m for step in steps]) - true_m
    smoothed_m = np.array([step.displacement_m for step in steps]) - true_m
    smoothed_inside = np.abs(smoothed_m) <= SIGMAS_95 * np.array([step.sigma_m for step in steps])
    scores = []
    for move, true in zip(moves.values(), truth.moves, strict=False):
        during = (t_s >= true.onset_s) & (t_s <= true.stop_s)
        scores.append(
            MoveScore(
                kind=str(move.kind),
                error_mm=(move.end_before_stop_m - true.end_m) * 1e3,
                sigma_mm=move.sigma_before_stop_m * 1e3,
                error_after_stop_mm=(move.end_m - true.end_m) * 1e3,
                rmse_mm=float(np.sqrt(np.mean(deviation_m[during] ** 2))) * 1e3,
                smoothed_rmse_mm=float(np.sqrt(np.mean(smoothed_m[during] ** 2))) * 1e3,
                smoothed_inside_95=float(smoothed_inside[during].mean()),
                onset_error_ms=(move.onset_ns * 1e-9 - true.onset_s) * 1e3,
                stop_error_ms=(move.stop_ns * 1e-9 - true.stop_s) * 1e3,
            )
        )
    return SeedResult(
        seed,
        mode,
        _failure(list(moves.values()), truth.moves),
        scores,
        [_clock_error_mm(t) for t in truth.moves],
    )


def _failure(moves: list[Move], truth: tuple[TrueMove, ...]) -> str:
    """What is wrong with the segmentation, in words; empty if nothing."""
    if len(moves) != len(truth):
        return f"{len(moves)} moves found, {len(truth)} made"
    for move, true in zip(moves, truth, strict=True):
        if (move.kind is MoveKind.PUSH) != (true.speed_m_s > 0):
            return f"move {move.number}: wrong direction"
        for name, found_ns, true_s in (
            ("onset", move.onset_ns, true.onset_s),
            ("stop", move.stop_ns, true.stop_s),
        ):
            if abs(found_ns * 1e-9 - true_s) > TIME_TOLERANCE_S:
                return f"move {move.number}: {name} {found_ns * 1e-9 - true_s:+.2f} s off"
        if abs(move.end_before_stop_m - true.end_m) > CATASTROPHE_M:
            return f"move {move.number}: {(move.end_before_stop_m - true.end_m) * 1e3:+.0f} mm off"
    return ""


def _clock_error_mm(true: TrueMove) -> float:
    """The baseline: nominal speed times the true duration of the move."""
    support = SupportSettings()
    nominal = support.nominal_push_speed_mm_s if true.speed_m_s > 0 else support.nominal_retract_speed_mm_s
    return nominal * (true.stop_s - true.onset_s) - abs(true.end_m - true.start_m) * 1e3


def evaluate(
    scenario: str, seeds: range, jobs: int = 1, progress: Callable[[int], None] | None = None
) -> list[SeedResult]:
    """All seeds in both modes; the same results whatever `jobs` is."""
    tasks = [(seed, scenario, mode) for mode in MODES for seed in seeds]
    done: dict[tuple[int, str, str], SeedResult] = {}
    if jobs == 1:
        for task in tasks:
            done[task] = evaluate_seed(*task)
            if progress is not None:
                progress(len(done))
    else:
        pool = ProcessPoolExecutor(jobs, get_context("spawn"), _end_on_interrupt)
        try:
            futures = {pool.submit(evaluate_seed, *task): task for task in tasks}
            for future in as_completed(futures):
                done[futures[future]] = future.result()
                if progress is not None:
                    progress(len(done))
        finally:
            # After Ctrl-C nobody waits for what is still queued.
            pool.shutdown(wait=False, cancel_futures=True)
    return [done[task] for task in tasks]


def _end_on_interrupt() -> None:
    """In a worker: Ctrl-C ends it at once, without a traceback of its own."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def summarise(results: list[SeedResult], kind: str) -> dict[str, Any]:
    """One row: figures over the records whose every move was right, and the count of the others."""
    good = [result for result in results if not result.failure]
    scores = [score for result in good for score in result.moves if score.kind == kind]
    if not scores:
        return {"records": len(results), "failures": len(results) - len(good)}
    error = np.abs([score.error_mm for score in scores])
    inside = np.abs([score.error_mm for score in scores]) <= SIGMAS_95 * np.array([s.sigma_mm for s in scores])
    normalised = np.array([score.error_mm / score.sigma_mm for score in scores])
    return {
        "records": len(results),
        "failures": len(results) - len(good),
        **_spread(error),
        "rmse_median_mm": float(np.median([score.rmse_mm for score in scores])),
        "smoothed_rmse_median_mm": float(np.median([score.smoothed_rmse_mm for score in scores])),
        "smoothed_inside_95": float(np.mean([score.smoothed_inside_95 for score in scores])),
        "coverage_95": float(inside.mean()),
        "nees": float(np.mean(normalised**2)),
        "onset_median_ms": float(np.median(np.abs([score.onset_error_ms for score in scores]))),
        "onset_p95_ms": float(np.percentile(np.abs([score.onset_error_ms for score in scores]), 95)),
        "stop_median_ms": float(np.median(np.abs([score.stop_error_ms for score in scores]))),
        "stop_p95_ms": float(np.percentile(np.abs([score.stop_error_ms for score in scores]), 95)),
    }


def summarise_clock(results: list[SeedResult], index: int) -> dict[str, Any]:
    """The baseline's row, for the move at `index` of the script."""
    error = np.abs([result.clock_errors_mm[index] for result in results])
    return {"records": len(results), "failures": 0, **_spread(error)}


def _spread(error_mm: NDArray[np.float64]) -> dict[str, float]:
    return {
        "median_mm": float(np.median(error_mm)),
        "p95_mm": float(np.percentile(error_mm, 95)),
        "worst_mm": float(error_mm.max()),
        "rms_mm": float(np.sqrt(np.mean(error_mm**2))),
    }
