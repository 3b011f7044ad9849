"""Scores summed up: rows of an evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.offline.evaluation.scenarios import SCENARIOS_OF_EVALUATION as SCENARIOS
from daemon.offline.evaluation.score import SIGMAS_95, Instant, SeedResult, rms


def summarise(results: list[SeedResult], index: int) -> dict[str, Any]:
    """One row, of the move at `index`: over the records whose every move was right; the others are counted, and their
    errors stand in the worst case."""
    good = [result for result in results if not result.failure]
    judged = [(result, score) for result in good if (score := result.moves[index]) is not None]
    scores = [score for _, score in judged]
    told = [score for result in results if (score := result.moves[index]) is not None]
    counts: dict[str, Any] = {"records": len(results), "failures": len(results) - len(good)}
    if told:
        counts["worst_mm"] = max(abs(score.error_mm) for score in told)
    if not scores:
        return counts
    normalised = np.array([score.error_mm / score.sigma_mm for score in scores])
    clock = np.array([result.clock_errors_mm[index] for result, _ in judged])
    row = {
        **spread(np.abs([score.error_mm for score in scores])),
        **counts,
        **_median_p95("rmse", "mm", [score.rmse_mm for score in scores]),
        **_median_p95("cvs_speed", "mm_s", [score.cvs_speed_error_mm_s for score in scores]),
        **_median_p95("mean_speed", "mm_s", [score.mean_speed_error_mm_s for score in scores]),
        "smoothed_rmse_median_mm": float(np.median([score.smoothed_rmse_mm for score in scores])),
        "smoothed_inside_95": float(np.mean([score.smoothed_inside_95 for score in scores])),
        "coverage_95": float(np.mean(np.abs(normalised) <= SIGMAS_95)),
        "nees": float(np.mean(normalised**2)),
        **_mean("nis", [score.nis for score in scores]),
        **_median_p95("onset", "ms", [score.onset_error_ms for score in scores]),
        **_median_p95("stop", "ms", [score.stop_error_ms for score in scores]),
        **_median_p95("proposed", "s", [score.proposed_s for score in scores]),
        **_median_p95("confirmed", "s", [score.confirmed_s for score in scores]),
        **_median_p95("told", "s", [score.told_s for score in scores]),
        "rms_of_clock": rms(np.array([score.error_mm for score in scores])) / max(rms(clock), 1e-9),
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


def _mean(name: str, values: Sequence[float]) -> dict[str, float]:
    finite = np.array(values)[np.isfinite(values)]
    return {name: float(finite.mean())} if len(finite) else {}


def _median_p95(name: str, unit: str, values: Sequence[float]) -> dict[str, float]:
    size = np.abs(np.array(values, dtype=np.float64))
    size = size[np.isfinite(size)]
    if not len(size):
        return {}
    return {f"{name}_median_{unit}": float(np.median(size)), f"{name}_p95_{unit}": float(np.percentile(size, 95))}


def summarise_rest(results: list[SeedResult]) -> dict[str, Any]:
    """False moves per hour of rest, of all records, with the exact interval of a Poisson count (Garwood 1936)."""
    from scipy.stats import chi2

    hours = sum(result.rest_s for result in results) / 3600
    count = sum(result.false_moves for result in results)
    low = chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    return {
        "hours": hours,
        "false_moves": count,
        "false_per_hour": count / hours,
        "false_per_hour_95": [float(low / hours), float(chi2.ppf(0.975, 2 * count + 2) / 2 / hours)],
    }


def summarise_clock(results: list[SeedResult], index: int) -> dict[str, Any]:
    """The baseline's row, for the move at `index` of the script."""
    error = np.abs([result.clock_errors_mm[index] for result in results])
    return {"records": len(results), "failures": 0, **spread(error)}


def row_names(scenario: str) -> list[str]:
    """Names of the judged moves of a scenario: `push`, or `push 2` where there are several."""
    kinds, position_m = [], 0.0
    judged = SCENARIOS[scenario]
    for move in judged.script:
        kinds.append("push" if move.target_m > position_m else "retract")
        position_m = move.target_m
    return [kind if kinds.count(kind) == 1 else f"{kind} {kinds[: i + 1].count(kind)}" for i, kind in enumerate(kinds)]


def spread(error_mm: NDArray[np.float64]) -> dict[str, float]:
    """Median, 95th percentile, worst and rms of absolute errors."""
    return {
        "median_mm": float(np.median(error_mm)),
        "p95_mm": float(np.percentile(error_mm, 95)),
        "worst_mm": float(error_mm.max()),
        "rms_mm": float(np.sqrt(np.mean(error_mm**2))),
    }
