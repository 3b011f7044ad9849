"""Q and R of paper A's two-state filter for given motions: by the truth, or by the innovations alone."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import reduce
from math import copysign, inf, isfinite, log10
from operator import add
from typing import Literal

import numpy as np

from estimation.arrays import FloatArray
from estimation.tuning import genetic, two_state_pass
from estimation.tuning.local import GRID, between_neighbours
from estimation.tuning.observed import Form, Observed, observed_at_every_step
from estimation.tuning.optimisers import AUTO, BUDGET, OPTIMISERS, run
from estimation.tuning.search import Found, Search, Spent
from estimation.tuning.two_state_pass import Fit

Goal = Literal["ml", "truth"]
INDEX = (-6.0, 2.0)  # log10 of the tracking index dt sqrt(Q_vv/R) searched: from deaf to believing each reading
WIDEST_DECADES = 2.0  # of the interval of log10(q/r): wider, and the data do not tell it
INTERVAL_XTOL = 0.01  # decades
SCANNED_AGAIN = 3  # best points of the scan that the filter itself looks at
CHI2_95 = 3.841459  # one degree of freedom
THREE_SIGMA = 9.0  # of the deviance over its least: 99.7 % of log10(q/r)
PAPER_BOX = [(-5.0, 5.0)] * 2  # of Q and R, paper A's population range; the size of a candidate counts
PAPER_START = np.array([2.0, 2.0])  # initial population of paper A's GA
LAGS = 20
LEAST_BUDGET = 20  # a generation of flies, or the grid
MISSED_DEVIANCE, MISSED_SHARE = 0.1, 1e-3  # over the optimum of the line: then a method has not found it


@dataclass(frozen=True)
class Check:
    """Whether the innovations are what a right filter's are."""

    whiteness_p: float  # Ljung-Box over 20 lags: below 0.01 they are not white
    nis: float  # mean of e^2/s; 1 by construction where R was fitted to them
    nis_inside_95: float  # share of them below the 95 % limit


@dataclass(frozen=True)
class Tuned:
    """Q and R, and how far the data determine them."""

    method: str
    goal: Goal
    form: Form
    q: float
    r: float
    value: float  # of the objective: mean squared error, or deviance
    interval: tuple[float, float] | None  # 3 sigma (99.7 %) of log10(q/r) by profile likelihood; None with a truth
    determined: bool
    better_log10_ratio: float | None  # what `auto` finds, where this method has missed the optimum
    evaluations: int  # of the search, its scan and the interval
    history: list[tuple[int, float]]
    check: Check

    @property
    def log10_ratio(self) -> float:
        """What the estimate depends on."""
        return log10(self.q / self.r)


def tune_kf2(
    u: FloatArray,
    y: FloatArray,
    dt: float,
    truth: FloatArray | None = None,
    form: Form = "BqB",
    method: str = AUTO,
    seed: int = 0,
    budget: int = BUDGET,
) -> Tuned:
    """Q and R for an input u and readings y (n,) at even steps of `dt`; against `truth` (n,) if there is one.

    The filter starts from x = 0 with P = 0 at the first step. Lengths in any one unit. Raises ValueError for data that
    nothing can be learned from, an unknown method or a budget below 1.
    """
    observed = observed_at_every_step(u, y, dt, truth, form)
    return tune([observed], form, method, "ml" if truth is None else "truth", seed, budget)


def tune(
    motions: Sequence[Observed], form: Form, method: str = AUTO, goal: Goal = "ml", seed: int = 0, budget: int = BUDGET
) -> Tuned:
    """Q and R that serve all motions together. Raises ValueError as `tune_kf2`, or where a truth is missing."""
    if not motions:
        raise ValueError("there is no motion to tune on")
    if goal == "truth" and any(motion.truth is None for motion in motions):
        raise ValueError("there is no true displacement to tune against; the objective ml needs none")
    if method not in OPTIMISERS:
        raise ValueError(f"the method {method} is unknown; there are {', '.join(OPTIMISERS)}")
    if budget < LEAST_BUDGET:
        raise ValueError(f"a budget of {budget} evaluations finds nothing; it must be {LEAST_BUDGET} or more")
    problem = _Problem(motions, goal)
    if OPTIMISERS[method].positive or OPTIMISERS[method].log10 or method in ("pso", "ga"):
        found, q, r = problem.by_both(method, seed, budget)
    else:
        found, q, r = problem.by_ratio(method, seed, budget)
    best = found if method in (AUTO, "grid") else problem.by_ratio(AUTO, seed, BUDGET)[0]
    best_ratio = float(best.x[0])
    interval = problem.interval(best_ratio) if goal == "ml" else None
    low, high = interval or (-inf, inf)
    return Tuned(
        method,
        goal,
        form,
        q,
        r,
        found.value,
        interval,
        high - low <= WIDEST_DECADES if interval else problem.is_inside(best_ratio),
        best_ratio if problem.is_missed(q / r, best.value) else None,
        found.evaluations + problem.more_evaluations,
        found.history,
        check(motions, q, r),
    )


def fit(motions: Sequence[Observed], ratio: FloatArray) -> Fit:
    """Exact sums over all motions for ratios (m,)."""
    return reduce(add, (two_state_pass.exact(motion, ratio) for motion in motions))


def check(motions: Sequence[Observed], q: float, r: float) -> Check:
    """Innovations of all motions under Q and R; lags stay within a motion."""
    from scipy.stats import chi2

    squares, products, n = [], np.zeros(LAGS), 0
    for motion in motions:
        e, s = two_state_pass.innovations(motion, q / r)
        z = e / np.sqrt(s * r)
        squares.append(z * z)
        products += [float(z[lag:] @ z[:-lag]) if lag < len(z) else 0.0 for lag in range(1, LAGS + 1)]
        n += len(z)
    nis = np.concatenate(squares)
    correlation = products / nis.sum()
    spread = n - np.arange(1, LAGS + 1)
    box = n * (n + 2) * float((correlation**2 / np.maximum(spread, 1)).sum())
    return Check(float(chi2.sf(box, LAGS)), float(nis.mean()), float((nis < CHI2_95).mean()))


class _Problem:
    """The objective over log10(q/r), or over Q and R."""

    def __init__(self, motions: Sequence[Observed], goal: Goal) -> None:
        self.motions, self.goal = motions, goal
        self.more_evaluations = 0
        dt = float(np.median(np.concatenate([motion.dt_s for motion in motions])))
        vv = float(np.median(np.concatenate([motion.noise[:, 2] for motion in motions])))
        low, high = (2.0 * (index - log10(dt)) - log10(vv) for index in INDEX)
        self.low, self.high = low, high

    def by_ratio(self, method: str, seed: int, budget: int) -> tuple[Found, float, float]:
        """One parameter, log10(q/r); R is the likeliest with it."""
        search = Search(
            lambda x: self._of(fit(self.motions, 10.0 ** x[:, 0])), np.array([self.low]), np.array([self.high]), budget
        )
        by_line = method in (AUTO, "grid")
        found = self._by_line(search) if by_line else run(search, OPTIMISERS[method].run, seed)
        ratio = 10.0 ** float(found.x[0])
        r = float(fit(self.motions, np.array([ratio])).r[0])
        if not (isfinite(r) and r > 0):
            raise ValueError("the readings follow the input exactly: there is no noise to tune for")
        return found, ratio * r, r

    def by_both(self, method: str, seed: int, budget: int) -> tuple[Found, float, float]:
        """Two parameters, Q and R, as the papers search them; likelihood then counts their size too."""
        optimiser = OPTIMISERS[method]
        middle = (self.low + self.high) / 2.0
        limits = [(10.0 ** (middle - 16.0), 10.0 ** (middle + 16.0))] * 2 if optimiser.log10 else PAPER_BOX
        low, high = np.array(limits).T
        search = Search(lambda x: self._of_both(np.abs(x)), low, high, budget)
        if method == "ga":
            found = run(search, lambda s, rng: genetic.evolve(s, rng, PAPER_START), seed)
        else:
            found = run(search, optimiser.run, seed)
        q, r = np.abs(found.x).tolist()
        return found, q, r

    def interval(self, log10_ratio: float) -> tuple[float, float]:
        """3 sigma of log10(q/r) by profile likelihood; an end beyond the range searched is infinite."""
        level = self._deviance(log10_ratio) + THREE_SIGMA
        return self._crossing(log10_ratio, -1.0, level), self._crossing(log10_ratio, 1.0, level)

    def _crossing(self, inner: float, decade: float, level: float) -> float:
        """Where the deviance first exceeds a level, going by decades."""
        from scipy.optimize import brentq

        while True:
            outer = min(max(inner + decade, self.low), self.high)
            if outer == inner:
                return copysign(inf, decade)
            if self._deviance(outer) > level:
                return float(brentq(lambda x: self._deviance(x) - level, inner, outer, xtol=INTERVAL_XTOL))
            inner = outer

    def is_missed(self, ratio: float, best: float) -> bool:
        """Whether a ratio is worse than the best value of the objective over log10(q/r)."""
        value = float(self._of(fit(self.motions, np.array([ratio])))[0])
        return value > (best + MISSED_DEVIANCE if self.goal == "ml" else best * (1.0 + MISSED_SHARE))

    def is_inside(self, log10_ratio: float) -> bool:
        """Whether the best is no end of the range searched."""
        margin = (self.high - self.low) / (GRID - 1) / 100
        return self.low + margin < log10_ratio < self.high - margin

    def _by_line(self, search: Search) -> Found:
        """The grid by the quick scan where steps are even, then the filter itself between the best one's neighbours."""
        grid = np.linspace(self.low, self.high, GRID)
        again = np.arange(GRID)
        if all(motion.is_uniform for motion in self.motions):
            sums = reduce(add, (two_state_pass.scan(motion, 10.0**grid) for motion in self.motions))
            again = np.argsort(self._of(sums), kind="stable")[:SCANNED_AGAIN]
            self.more_evaluations += GRID
        values = np.full(GRID, inf)
        with suppress(Spent):
            values[again] = search(grid[again, None])
            between_neighbours(search, grid, values)
        return search.found()

    def _of(self, sums: Fit) -> FloatArray:
        return sums.mse if self.goal == "truth" else sums.deviance

    def _of_both(self, q_r: FloatArray) -> FloatArray:
        q, r = q_r.T
        sums = fit(self.motions, q / r)
        if self.goal == "truth":
            return sums.mse
        return np.asarray(sums.weighted / r + sums.readings * np.log(r) + sums.log_s)

    def _deviance(self, log10_ratio: float) -> float:
        self.more_evaluations += 1
        return float(fit(self.motions, np.array([10.0**log10_ratio])).deviance[0])
