"""A run of the estimator against the truth: one score per move of the judged script."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from math import nan

import numpy as np
from numpy.typing import NDArray

from daemon.offline.evaluation.scenarios import EvaluationScenario
from drivers.virtual.motion import TrueMove
from drivers.virtual.support import VirtualSupport
from estimation.displacement.sensor import GATE_SIGMAS
from estimation.records import CanState, Estimate, Event, Move, MoveKind, Output, Tier
from estimation.settings import SupportSettings
from estimation.smoothing.settled_smoother import SmoothedStep

CATASTROPHE_M = 0.05
STANDS_S = 1.0  # after the start of deceleration every ram stands
BURST_S, BRAKING_S = 1.0, 0.2  # at both ends of a move, no part of its constant-velocity segment
SIGMAS_95 = 1.96


@dataclass(frozen=True)
class Instant:
    """What was stated at a moment, against the truth."""

    error_mm: float
    sigma_mm: float


@dataclass(frozen=True)
class MoveScore:
    """One move against the truth.

    A move without a summary (missed, or the sensor cannot feel it) is judged by the settled stroke once the ram
    stands; what only a summary tells is NaN then.
    """

    kind: str  # true direction
    error_mm: float  # before any mechanical-stop constraint
    sigma_mm: float
    error_after_stop_mm: float
    sigma_after_stop_mm: float
    rmse_mm: float  # settled tier, over the move
    smoothed_rmse_mm: float
    smoothed_inside_95: float  # share of the move's steps within the stated 95 %
    cvs_speed_error_mm_s: float  # rms in the constant-velocity segment, settled tier; NaN in a short move
    mean_speed_error_mm_s: float  # of the summary, against the truth of the same segment
    onset_error_ms: float
    stop_error_ms: float
    proposed_s: float  # after the onset; NaN if another way
    confirmed_s: float
    told_s: float  # the whole move, after its stop
    nis: float  # mean squared innovation of the readings used in the move, in their sigmas; NaN without any
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
    moves: list[MoveScore | None] = field(default_factory=list)  # one per true move; None = nothing could tell it
    clock_errors_mm: list[float] = field(default_factory=list)  # nominal speed x true time, per move
    rest_s: float = 0.0  # judged rest, where nothing but rest is judged
    false_moves: int = 0  # found in it


class Run:
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
        self._nis = np.array([_nis(step.settled) for step in steps])
        self._smoothed_m = np.array([step.displacement_m for step in steps]) - true_m
        self._smoothed_inside = np.abs(self._smoothed_m) <= SIGMAS_95 * np.array([step.sigma_m for step in steps])

    def summary_of(self, true: TrueMove, found: Iterable[Move]) -> Move | None:
        """The first move found that overlaps the true one in time."""
        onset_ns, stop_ns = ((self._start_s + t_s) * 1e9 for t_s in (true.onset_s, true.stop_s))
        return next((move for move in found if move.onset_ns < stop_ns and move.stop_ns > onset_ns), None)

    def score(self, move: Move | None, true: TrueMove, instant: float, told_s: float) -> MoveScore:
        """One move; `instant`: share of the time from its onset to 2 s after its stop."""
        onset_s, stop_s = self._start_s + true.onset_s, self._start_s + true.stop_s
        during = (self._t_s >= onset_s) & (self._t_s <= stop_s)
        even_s = (onset_s + BURST_S, stop_s - BRAKING_S)
        even = (self._t_s >= even_s[0]) & (self._t_s <= even_s[1])
        at_s = onset_s + instant * (stop_s + 2.0 - onset_s)
        if move is None:
            end = after = self._at(self._settled, stop_s + STANDS_S)
            onset_error_s = stop_error_s = mean_speed_error_m_s = nan
        else:
            end = _instant(move.end_before_stop_m, true.end_m, move.sigma_before_stop_m)
            after = _instant(move.end_m, true.end_m, move.sigma_m)
            onset_error_s, stop_error_s = move.onset_ns * 1e-9 - onset_s, move.stop_ns * 1e-9 - stop_s
            mean_speed_error_m_s = abs(move.velocity_m_s) - self._mean_speed_m_s(*even_s)
        return MoveScore(
            kind=str(_kind(true)),
            error_mm=end.error_mm,
            sigma_mm=end.sigma_mm,
            error_after_stop_mm=after.error_mm,
            sigma_after_stop_mm=after.sigma_mm,
            rmse_mm=rms(self._deviation_m[during]) * 1e3,
            smoothed_rmse_mm=rms(self._smoothed_m[during]) * 1e3,
            smoothed_inside_95=float(self._smoothed_inside[during].mean()),
            cvs_speed_error_mm_s=rms(self._speed_off_m_s[even]) * 1e3 if even.any() else nan,
            mean_speed_error_mm_s=mean_speed_error_m_s * 1e3,
            onset_error_ms=onset_error_s * 1e3,
            stop_error_ms=stop_error_s * 1e3,
            proposed_s=self._event_s("start proposed", onset_s),
            confirmed_s=self._event_s("start confirmed", onset_s),
            told_s=told_s - stop_s,
            nis=float(np.mean(nis)) if len(nis := self._nis[during & np.isfinite(self._nis)]) else nan,
            provisional=self._at(self._provisional, at_s),
            settled=self._at(self._settled, at_s),
        )

    def _event_s(self, words: str, onset_s: float) -> float:
        """Delay of the first such event within 3 s, NaN without one."""
        delays = (event.t_ns * 1e-9 - onset_s for event in self._events if event.what.startswith(words))
        return next((delay for delay in delays if -0.2 < delay < 3.0), nan)

    def _mean_speed_m_s(self, begin_s: float, end_s: float) -> float:
        """True mean speed between two times, NaN if the second is not later."""
        begin_m, end_m = np.interp([begin_s, end_s], self._true_s, self._true_m).tolist()
        return abs(end_m - begin_m) / (end_s - begin_s) if end_s > begin_s else nan

    def _at(self, estimates: Sequence[Estimate], t_s: float) -> Instant:
        place = min(bisect_left(estimates, t_s * 1e9, key=lambda e: e.t_ns), len(estimates) - 1)
        estimate = estimates[place]
        true_m = float(np.interp(estimate.t_ns * 1e-9, self._true_s, self._true_m))
        return _instant(estimate.displacement_m, true_m, estimate.sigma_m)


def _nis(estimate: Estimate) -> float:
    """Of the reading that was used in this step; NaN if none was."""
    if estimate.can_state not in (CanState.OK, CanState.LATE) or not abs(estimate.innovation_m) <= estimate.gate_m:
        return nan
    return (GATE_SIGMAS * estimate.innovation_m / estimate.gate_m) ** 2


def _instant(stated_m: float, true_m: float, sigma_m: float) -> Instant:
    return Instant((stated_m - true_m) * 1e3, sigma_m * 1e3)


def _kind(true: TrueMove) -> MoveKind:
    return MoveKind.PUSH if true.speed_m_s > 0 else MoveKind.RETRACT


def rms(values: NDArray[np.float64]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def failure_of(
    run: Run,
    found: list[Move],
    truth: Sequence[TrueMove],
    scores: Sequence[MoveScore | None],
    scenario: EvaluationScenario,
) -> str:
    """What is wrong with the record, in words; empty if nothing."""
    summaries = [run.summary_of(true, found) for true in truth]
    # A move that the sensor cannot feel needs no summary, but may have one.
    free = {m.number for m, true in zip(summaries, truth, strict=True) if m is not None and not scenario.felt(true)}
    felt = sum(scenario.felt(true) for true in truth)
    if (count := sum(move.number not in free for move in found)) != felt:
        return f"{count} moves found, {felt} made"
    for place, (move, true, score) in enumerate(zip(summaries, truth, scores, strict=True), 1):
        if score is None:
            continue
        if move is None and scenario.felt(true):
            return f"move {place}: missed"
        if move is not None and move.kind is not _kind(true):
            return f"move {place}: wrong direction"
        for name, off_ms in (("onset", score.onset_error_ms), ("stop", score.stop_error_ms)):
            if abs(off_ms) > scenario.time_tolerance_s * 1e3:
                return f"move {place}: {name} {off_ms * 1e-3:+.2f} s off"
        if not abs(score.error_mm) <= CATASTROPHE_M * 1e3:  # NaN is a failure, too
            return f"move {place}: {score.error_mm:+.0f} mm off"
    return ""


def clock_error_mm(true: TrueMove) -> float:
    """The baseline: nominal speed times the true duration of the move."""
    support = SupportSettings()
    nominal = support.nominal_push_speed_mm_s if true.speed_m_s > 0 else support.nominal_retract_speed_mm_s
    return nominal * (true.stop_s - true.onset_s) - abs(true.end_m - true.start_m) * 1e3
