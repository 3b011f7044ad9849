"""Paper B's six test functions. The paper prints neither formulas nor dimensions: only these fit its Table 1."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimation.arrays import FloatArray

SIDE = 5.0  # all of them side by side on +-5
SHIFT = 2.0  # optima moved by U(-2, 2) per coordinate, the box widened by as much


@dataclass(frozen=True)
class Function:
    """A function over d coordinates and its least value."""

    title: str
    of: Callable[[FloatArray], FloatArray]  # (m, d) -> (m,)
    dimension: int
    optimum: float
    at: tuple[float, ...]


def _ackley(x: FloatArray) -> FloatArray:
    rms, ripple = np.sqrt((x**2).mean(axis=1)), np.cos(2 * np.pi * x).mean(axis=1)
    return np.asarray(-20 * np.exp(-0.2 * rms) - np.exp(ripple) + 20 + np.e)


def _griewank(x: FloatArray) -> FloatArray:
    ripple = np.cos(x / np.sqrt(np.arange(1, x.shape[1] + 1))).prod(axis=1)
    return np.asarray((x**2).sum(axis=1) / 4000 - ripple + 1)


def _zettl(x: FloatArray) -> FloatArray:
    a, b = x.T
    return np.asarray((a**2 + b**2 - 2 * a) ** 2 + 0.25 * a)


def _test_tube_holder(x: FloatArray) -> FloatArray:
    a, b = x.T
    return np.asarray(-4 * np.abs(np.sin(a) * np.cos(b) * np.exp(np.abs(np.cos((a**2 + b**2) / 200)))))


def _helical_valley(x: FloatArray) -> FloatArray:
    a, b, z = x.T
    turn = np.arctan2(b, a) / (2 * np.pi)
    return np.asarray(100 * ((z - 10 * turn) ** 2 + (np.hypot(a, b) - 1) ** 2) + z**2)


def _wood(x: FloatArray) -> FloatArray:
    a, b, c, d = x.T
    return np.asarray(
        100 * (a**2 - b) ** 2
        + (a - 1) ** 2
        + (c - 1) ** 2
        + 90 * (c**2 - d) ** 2
        + 10.1 * ((b - 1) ** 2 + (d - 1) ** 2)
        + 19.8 * (b - 1) * (d - 1)
    )


FUNCTIONS = {
    "ackley": Function("Ackley", _ackley, 2, 0.0, (0.0, 0.0)),
    "griewank": Function("Griewank", _griewank, 2, 0.0, (0.0, 0.0)),
    "zettl": Function("Zettl", _zettl, 2, -0.003791237220469, (-0.02989598, 0.0)),
    "test_tube_holder": Function("Testtubeholder", _test_tube_holder, 2, -10.872300105622747, (1.57060263, 0.0)),
    "helical_valley": Function("Helicalvalley", _helical_valley, 3, 0.0, (1.0, 0.0, 0.0)),
    "wood": Function("Wood", _wood, 4, 0.0, (1.0, 1.0, 1.0, 1.0)),
}


def shifted(function: Function, seed: int) -> Function:
    """The same with its optimum elsewhere, drawn by `seed`: an optimum at the origin favours whoever runs there."""
    shift = np.random.default_rng(seed).uniform(-SHIFT, SHIFT, function.dimension)
    at = tuple(float(v) for v in np.array(function.at) + shift)
    return Function(function.title, lambda x: function.of(x - shift), function.dimension, function.optimum, at)


def box_of(function: Function, *, is_shifted: bool) -> list[tuple[float, float]]:
    """The box to search."""
    side = SIDE + SHIFT if is_shifted else SIDE
    return [(-side, side)] * function.dimension
