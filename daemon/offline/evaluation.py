"""Accuracy by Monte Carlo: the estimator on many virtual supports, beside the clock, truth known.

The sensor is computed in arrays here instead of being read over SPI word by word; filters, quantisation and
everything behind the driver are the same.
"""

from __future__ import annotations

import signal
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.offline.scenarios import SCENARIOS_OF_EVALUATION as SCENARIOS
from daemon.offline.scenarios import EvaluationScenario
from drivers.adis16448.registers import ACCEL_LSB, GYRO_LSB_DPS
from drivers.virtual.adis16448_signal import HISTORY, FilterPath
from drivers.virtual.controller import Observation
from drivers.virtual.motion import TrueMove
from drivers.virtual.support import PlacedTrajectory, VirtualSupport
from estimation.pipeline import Pipeline, Start
from estimation.records import Displacement, Estimate, Event, ImuSample, Move, MoveKind, Output, Record, Tier
from estimation.settings import MountSettings, SupportSettings
from estimation.settled_smoother import SettledSmoother, SmoothedStep

FILTER_TAPS_EXPONENT, GYRO_RANGE_DPS = 2, 500  # the driver's defaults
CATASTROPHE_M = 0.05
SIGMAS_95 = 1.96
MODES = ("fused", "inertial")


@dataclass(frozen=True)
class Instant:
    """What was stated at a moment, against the truth."""

    error_mm: float
    sigma_mm: float


@dataclass(frozen=True)
class MoveScore:
    """One move against the truth."""

    kind: str
    error_mm: float  # before any mechanical-stop constraint
    sigma_mm: float
    error_after_stop_mm: float
    sigma_after_stop_mm: float
    rmse_mm: float  # settled tier, over the move
    smoothed_rmse_mm: float
    smoothed_inside_95: float  # share of the move's steps within the stated 95 %
    cvs_speed_error_mm_s: float  # rms in the constant-velocity segment, settled tier; NaN in a short move
    onset_error_ms: float
    stop_error_ms: float
    proposed_s: float  # after the onset; NaN if another way
    confirmed_s: float
    told_s: float  # the whole move, after its stop
    # At one instant drawn between onset and 2 s after the stop: one value a move, so that moves are independent.
    provisional: Instant
    settled: Instant


@dataclass(frozen=True)
class Case:
    """One virtual support to be judged."""

    scenario: str
    seed: int
    mode: str  # of the judged cycle; the warm-up has the displacement sensor
    warm_up: int = 0


@dataclass(frozen=True)
class SeedResult:
    """How one case went."""

    case: Case
    failure: str = ""  # why the record counts as failed; empty = every move right
    moves: list[MoveScore] = field(default_factory=list)
    clock_errors_mm: list[float] = field(default_factory=list)  # nominal speed x true time, per move


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


def _readings(
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


def evaluate_case(case: Case) -> SeedResult:
    """Play the support, estimate, compare."""
    scenario, support = SCENARIOS[case.scenario], virtual_support(case)
    judged = support.placed(case.warm_up)
    pipeline = Pipeline(mount=MountSettings(imu_on=scenario.imu_on), start=Start(0.0))
    steps: list[SmoothedStep] = []
    smoother = SettledSmoother(pipeline, steps.append)
    outputs: list[Output] = []
    told_s: dict[int, float] = {}
    for record in records_of(support, _readings(support, scenario, judged, fused=case.mode == "fused")):
        for out in pipeline.feed(record):
            outputs.append(out)
            if isinstance(out, Move):
                told_s[out.number] = record.t_ns * 1e-9
    outputs += pipeline.finish()
    smoother.finish()

    run = _Run(support, case.warm_up, outputs, steps)
    found = {out.number: out for out in outputs if isinstance(out, Move) and out.stop_ns * 1e-9 > judged.start_s}
    true = [move for move in judged.trajectory.moves if scenario.felt(move)]
    rng = np.random.default_rng([case.seed, 95])
    instants = [rng.uniform() for _ in true]
    failure = _failure(list(found.values()), true, judged.start_s, scenario.time_tolerance_s)
    scores = [
        run.score(move, made, instant, told_s.get(move.number, float("nan")))
        for move, made, instant in zip(found.values(), true, instants, strict=False)
    ]
    return SeedResult(case, failure, scores, [_clock_error_mm(t) for t in true])


class _Run:
    """The outputs of a run beside its truth."""

    def __init__(self, support: VirtualSupport, cycle: int, outputs: list[Output], steps: list[SmoothedStep]) -> None:
        placed = [support.placed(i) for i in range(cycle + 1)]
        self._start_s = placed[-1].start_s
        self._true_s = np.concatenate([p.t_s for p in placed])
        self._true_m = np.concatenate([p.trajectory.displacement_m for p in placed])
        self._true_m_s = np.concatenate([p.trajectory.velocity_m_s for p in placed])
        self._provisional = [out for out in outputs if isinstance(out, Estimate) and out.tier is Tier.PROVISIONAL]
        self._events = [out for out in outputs if isinstance(out, Event)]
        self._settled = [step.settled for step in steps]
        self._t_s = np.array([step.settled.t_ns for step in steps]) * 1e-9
        true_m = np.interp(self._t_s, self._true_s, self._true_m)
        self._deviation_m = np.array([step.settled.displacement_m for step in steps]) - true_m
        self._speed_off_m_s = np.array([step.settled.velocity_m_s for step in steps]) - np.interp(
            self._t_s, self._true_s, self._true_m_s
        )
        self._smoothed_m = np.array([step.displacement_m for step in steps]) - true_m
        self._smoothed_inside = np.abs(self._smoothed_m) <= SIGMAS_95 * np.array([step.sigma_m for step in steps])

    def score(self, move: Move, true: TrueMove, instant: float, told_s: float) -> MoveScore:
        """One move; `instant`: share of the time from its onset to 2 s after its stop."""
        onset_s, stop_s = self._start_s + true.onset_s, self._start_s + true.stop_s
        during = (self._t_s >= onset_s) & (self._t_s <= stop_s)
        even = (self._t_s >= onset_s + 1.0) & (self._t_s <= stop_s - 0.2)
        at_s = onset_s + instant * (stop_s + 2.0 - onset_s)
        return MoveScore(
            kind=str(move.kind),
            error_mm=(move.end_before_stop_m - true.end_m) * 1e3,
            sigma_mm=move.sigma_before_stop_m * 1e3,
            error_after_stop_mm=(move.end_m - true.end_m) * 1e3,
            sigma_after_stop_mm=move.sigma_m * 1e3,
            rmse_mm=_rms(self._deviation_m[during]) * 1e3,
            smoothed_rmse_mm=_rms(self._smoothed_m[during]) * 1e3,
            smoothed_inside_95=float(self._smoothed_inside[during].mean()),
            cvs_speed_error_mm_s=_rms(self._speed_off_m_s[even]) * 1e3 if even.any() else float("nan"),
            onset_error_ms=(move.onset_ns * 1e-9 - onset_s) * 1e3,
            stop_error_ms=(move.stop_ns * 1e-9 - stop_s) * 1e3,
            proposed_s=self._event_s("start proposed", onset_s),
            confirmed_s=self._event_s("start confirmed", onset_s),
            told_s=told_s - stop_s,
            provisional=self._at(self._provisional, at_s),
            settled=self._at(self._settled, at_s),
        )

    def _event_s(self, words: str, onset_s: float) -> float:
        """Delay of the first such event within 3 s, NaN without one."""
        delays = (event.t_ns * 1e-9 - onset_s for event in self._events if event.what.startswith(words))
        return next((delay for delay in delays if -0.2 < delay < 3.0), float("nan"))

    def _at(self, estimates: Sequence[Estimate], t_s: float) -> Instant:
        place = min(bisect_left(estimates, t_s * 1e9, key=lambda e: e.t_ns), len(estimates) - 1)
        estimate = estimates[place]
        true_m = float(np.interp(estimate.t_ns * 1e-9, self._true_s, self._true_m))
        return Instant((estimate.displacement_m - true_m) * 1e3, estimate.sigma_m * 1e3)


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _failure(moves: list[Move], truth: list[TrueMove], start_s: float, tolerance_s: float) -> str:
    """What is wrong with the segmentation, in words; empty if nothing."""
    if len(moves) != len(truth):
        return f"{len(moves)} moves found, {len(truth)} made"
    for place, (move, true) in enumerate(zip(moves, truth, strict=True), 1):
        if (move.kind is MoveKind.PUSH) != (true.speed_m_s > 0):
            return f"move {place}: wrong direction"
        for name, found_ns, true_s in (
            ("onset", move.onset_ns, true.onset_s),
            ("stop", move.stop_ns, true.stop_s),
        ):
            off_s = found_ns * 1e-9 - start_s - true_s
            if abs(off_s) > tolerance_s:
                return f"move {place}: {name} {off_s:+.2f} s off"
        if abs(move.end_before_stop_m - true.end_m) > CATASTROPHE_M:
            return f"move {place}: {(move.end_before_stop_m - true.end_m) * 1e3:+.0f} mm off"
    return ""


def _clock_error_mm(true: TrueMove) -> float:
    """The baseline: nominal speed times the true duration of the move."""
    support = SupportSettings()
    nominal = support.nominal_push_speed_mm_s if true.speed_m_s > 0 else support.nominal_retract_speed_mm_s
    return nominal * (true.stop_s - true.onset_s) - abs(true.end_m - true.start_m) * 1e3


def evaluate(cases: Sequence[Case], jobs: int = 1, progress: Callable[[int], None] | None = None) -> list[SeedResult]:
    """All cases, in their order; the same results whatever `jobs` is."""
    done: dict[Case, SeedResult] = {}
    if jobs == 1:
        for case in cases:
            done[case] = evaluate_case(case)
            if progress is not None:
                progress(len(done))
    else:
        pool = ProcessPoolExecutor(jobs, get_context("spawn"), _end_on_interrupt)
        try:
            futures = {pool.submit(evaluate_case, case): case for case in cases}
            for future in as_completed(futures):
                done[futures[future]] = future.result()
                if progress is not None:
                    progress(len(done))
        finally:
            # After Ctrl-C nobody waits for what is still queued.
            pool.shutdown(wait=False, cancel_futures=True)
    return [done[case] for case in cases]


def _end_on_interrupt() -> None:
    """In a worker: Ctrl-C ends it at once, without a traceback of its own."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def summarise(results: list[SeedResult], index: int) -> dict[str, Any]:
    """One row, of the move at `index`: over the records whose every move was right, the others counted."""
    good = [result for result in results if not result.failure]
    scores = [result.moves[index] for result in good]
    if not scores:
        return {"records": len(results), "failures": len(results) - len(good)}
    normalised = np.array([score.error_mm / score.sigma_mm for score in scores])
    clock = np.array([result.clock_errors_mm[index] for result in good])
    row = {
        "records": len(results),
        "failures": len(results) - len(good),
        **_spread(np.abs([score.error_mm for score in scores])),
        **_median_p95("rmse", "mm", [score.rmse_mm for score in scores]),
        **_median_p95("cvs_speed", "mm_s", [score.cvs_speed_error_mm_s for score in scores]),
        "smoothed_rmse_median_mm": float(np.median([score.smoothed_rmse_mm for score in scores])),
        "smoothed_inside_95": float(np.mean([score.smoothed_inside_95 for score in scores])),
        "coverage_95": float(np.mean(np.abs(normalised) <= SIGMAS_95)),
        "nees": float(np.mean(normalised**2)),
        **_median_p95("onset", "ms", [score.onset_error_ms for score in scores]),
        **_median_p95("stop", "ms", [score.stop_error_ms for score in scores]),
        **_median_p95("proposed", "s", [score.proposed_s for score in scores]),
        **_median_p95("confirmed", "s", [score.confirmed_s for score in scores]),
        **_median_p95("told", "s", [score.told_s for score in scores]),
        "rms_of_clock": _rms(np.array([score.error_mm for score in scores])) / max(_rms(clock), 1e-9),
        "rms_of_clock_95": _ratio_interval(np.array([score.error_mm for score in scores]), clock),
    }
    for tier in ("provisional", "settled"):
        stated: list[Instant] = [getattr(score, tier) for score in scores]
        ratio = np.array([instant.error_mm / instant.sigma_mm for instant in stated])
        row |= {
            f"{tier}_coverage_95": float(np.mean(np.abs(ratio) <= SIGMAS_95)),
            f"{tier}_nees": float(np.mean(ratio**2)),
        }
    return row | consistent_intervals(len(scores))


def consistent_intervals(n: int) -> dict[str, list[float]]:
    """Where coverage and NEES of `n` moves lie with probability 99 % if what is stated is true."""
    from scipy.stats import binom, chi2

    return {
        "coverage_99": [float(binom.ppf(q, n, 0.95)) / n for q in (0.005, 0.995)],
        "nees_99": [float(chi2.ppf(q, n)) / n for q in (0.005, 0.995)],
    }


def _ratio_interval(ours: NDArray[np.float64], clock: NDArray[np.float64]) -> list[float]:
    """Interval (95 %, paired bootstrap) of our rms error as a share of the clock's."""
    rng = np.random.default_rng(95)
    drawn = rng.integers(0, len(ours), (2000, len(ours)))
    ratio = np.sqrt((ours[drawn] ** 2).mean(axis=1) / np.maximum((clock[drawn] ** 2).mean(axis=1), 1e-12))
    return [float(x) for x in np.percentile(ratio, [2.5, 97.5])]


def _median_p95(name: str, unit: str, values: Sequence[float]) -> dict[str, float]:
    size = np.abs(np.array(values, dtype=np.float64))
    size = size[np.isfinite(size)]
    if not len(size):
        return {}
    return {f"{name}_median_{unit}": float(np.median(size)), f"{name}_p95_{unit}": float(np.percentile(size, 95))}


def summarise_clock(results: list[SeedResult], index: int) -> dict[str, Any]:
    """The baseline's row, for the move at `index` of the script."""
    error = np.abs([result.clock_errors_mm[index] for result in results])
    return {"records": len(results), "failures": 0, **_spread(error)}


def row_names(scenario: str) -> list[str]:
    """Names of the judged moves of a scenario: `push`, or `push 2` where there are several."""
    kinds, position_m = [], 0.0
    judged = SCENARIOS[scenario]
    for move in judged.script:
        push = move.target_m > position_m
        position_m = move.target_m
        if judged.imu_on == "both" or (judged.imu_on == "link") == push:
            kinds.append("push" if push else "retract")
    return [kind if kinds.count(kind) == 1 else f"{kind} {kinds[: i + 1].count(kind)}" for i, kind in enumerate(kinds)]


def _spread(error_mm: NDArray[np.float64]) -> dict[str, float]:
    return {
        "median_mm": float(np.median(error_mm)),
        "p95_mm": float(np.percentile(error_mm, 95)),
        "worst_mm": float(error_mm.max()),
        "rms_mm": float(np.sqrt(np.mean(error_mm**2))),
    }
