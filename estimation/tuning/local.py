"""The product's own searches: a line searched by a grid and bounded steps, a box by many local descents."""

from __future__ import annotations

import numpy as np

from estimation.arrays import FloatArray
from estimation.tuning.search import Search

GRID = 17
LINE_XATOL = 1e-7  # of the parameter; the objective is flat to second order at its least, 1e-7 is far below what shows
SURVEY = 0.05  # of the budget, for the points that the descents start from
POLISH = 0.1  # of the budget, for Nelder-Mead from the best that the descents have found
STEP_EPS = 1e-7  # of finite differences, of the box's width
DEAR_XATOL = 0.05  # of the first step, where each evaluation is a run over recordings
DESCENT_FTOL = 1e-7  # of the spread of values: nearer comes Nelder-Mead, more starts are worth more


def line(search: Search) -> None:
    """One parameter: a grid of 17 over the range, then Brent's bounded search between the best one's neighbours."""
    grid = np.linspace(search.low[0], search.high[0], GRID)
    values = search(grid[:, None])
    between_neighbours(search, grid[: len(values)], values)


def between_neighbours(search: Search, grid: FloatArray, values: FloatArray) -> None:
    """Brent's bounded search around the best point (m,) of a grid."""
    from scipy.optimize import minimize_scalar

    i = int(np.argmin(values))
    minimize_scalar(
        lambda x: search.one(np.array([x])),
        bounds=(grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]),
        method="bounded",
        options={"xatol": LINE_XATOL * float(np.ptp(grid))},
    )


def many_starts(search: Search, rng: np.random.Generator) -> None:
    """Several parameters: L-BFGS-B from points of a low-discrepancy sequence, the best first; then Nelder-Mead.

    Works in units of the box and of the values' spread over it: parameters and objectives of any size are alike.
    """
    from scipy.optimize import minimize
    from scipy.stats import qmc

    low, width = search.low, search.high - search.low
    box = [(0.0, 1.0)] * search.dimension
    starts = qmc.Halton(search.dimension, rng=rng).random(max(round(search.budget * SURVEY), 1))
    values = search(low + width * starts)
    starts = starts[np.argsort(values[: len(starts)], kind="stable")]
    finite = values[np.isfinite(values)]
    spread = float(np.ptp(finite)) if len(finite) else 0.0
    scale = 1.0 / spread if spread > 0 else 1.0

    def value(unit: FloatArray) -> float:
        return scale * search.one(low + width * unit)

    last = max(round(search.budget * POLISH), 1)
    for start in starts:
        if search.left <= last:
            break
        minimize(
            value,
            start,
            method="L-BFGS-B",
            bounds=box,
            options={"eps": STEP_EPS, "maxfun": search.left - last, "ftol": DESCENT_FTOL},
        )
    if search.best_x is not None:  # it has none where all was infinite
        best = (search.best_x - low) / width
        minimize(value, best, method="Nelder-Mead", bounds=box, options={"xatol": 1e-12, "fatol": 0.0})


def from_point(search: Search, start: FloatArray, step: float) -> None:
    """Nelder-Mead from a point (d,) that is good already, for objectives that are dear: a few dozen evaluations."""
    from scipy.optimize import Bounds, minimize

    minimize(
        search.one,
        start,
        method="Nelder-Mead",
        bounds=Bounds(search.low, search.high),
        options={
            "initial_simplex": np.vstack([start, start + step * np.eye(len(start))]),
            "xatol": DEAR_XATOL * step,
            "fatol": 0.0,
        },
    )
