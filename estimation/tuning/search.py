"""A search for the least value of an objective over a box: what every tuner gets, and what it gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimation.arrays import FloatArray

Bounds = Sequence[tuple[float, float]]
Objective = Callable[[FloatArray], FloatArray]  # (m, d) candidates -> (m,) values


class Spent(Exception):
    """The budget has run out; `minimize` catches it."""


@dataclass(frozen=True)
class Found:
    """The best that a search has seen."""

    x: FloatArray  # (d,)
    value: float
    evaluations: int
    history: list[tuple[int, float]]  # evaluations used, best value, at each improvement
    failed: int = 0  # evaluations whose value was no finite number; they count as infinitely bad


@dataclass
class Search:
    """The objective with its box, counting evaluations and remembering the best. Raises Spent at the budget's end."""

    objective: Objective
    low: FloatArray  # (d,)
    high: FloatArray  # (d,)
    budget: int
    evaluations: int = 0
    failed: int = 0
    best_x: FloatArray | None = None
    best_value: float = float("inf")
    history: list[tuple[int, float]] = field(default_factory=list)

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.low)

    @property
    def left(self) -> int:
        """Evaluations that may still be asked for."""
        return self.budget - self.evaluations

    def __call__(self, candidates: FloatArray) -> FloatArray:
        """Values (m,) of candidates (m, d), as many of them as the budget allows."""
        if self.left <= 0:
            raise Spent
        candidates = candidates[: self.left]
        with np.errstate(all="ignore"):  # an overflow gives no finite value, and that is counted
            values = np.asarray(self.objective(candidates), dtype=np.float64)
        bad = ~np.isfinite(values)
        self.failed += int(bad.sum())
        values = np.where(bad, np.inf, values)
        first = self.evaluations
        self.evaluations += len(candidates)
        for i in np.flatnonzero(values < self.best_value):
            if values[i] < self.best_value:
                self.best_x, self.best_value = candidates[i].copy(), float(values[i])
                self.history.append((first + int(i) + 1, self.best_value))
        return values

    def one(self, candidate: FloatArray) -> float:
        """Value of one candidate (d,)."""
        return float(self(np.asarray(candidate, dtype=np.float64)[None, :])[0])

    def found(self) -> Found:
        """The result so far. Raises ValueError where nothing had a finite value."""
        if self.best_x is None:
            raise ValueError(f"the objective has no finite value at any of {self.evaluations} candidates")
        return Found(self.best_x, self.best_value, self.evaluations, self.history, self.failed)


def box(bounds: Bounds) -> tuple[FloatArray, FloatArray]:
    """Low and high limits (d,) each. Raises ValueError if they are no box."""
    limits = np.asarray(bounds, dtype=np.float64)
    if limits.ndim != 2 or limits.shape[1] != 2 or not len(limits):
        raise ValueError("bounds must be pairs (low, high), one for each parameter")
    if not np.isfinite(limits).all():
        raise ValueError("bounds must be finite numbers")
    for number, (low, high) in enumerate(limits, 1):
        if low >= high:
            raise ValueError(f"limits of parameter {number} are reversed or empty: {low:g} to {high:g}")
    return limits[:, 0].copy(), limits[:, 1].copy()
