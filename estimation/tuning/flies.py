"""Fruit-fly optimisers of papers A and B, as read from their equations, and the same flies in log10 coordinates.

A swarm sits at a location; its flies leave it by random steps; the one that smells best draws the swarm to it. A fly
is not the candidate: each parameter has a coordinate X and Y (and Z) of its own, and the candidate is S = 1/Dist, eq.
(9). So S is always positive and its size is tied to the size of the steps: with steps of 3.1 an S below 0.1 or above 3
is rare. That is the method's weakness on Q and R, whose scale nobody knows; in log10 coordinates, where the location is
the logarithm of the parameter itself, it is gone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from estimation.arrays import FloatArray
from estimation.tuning.search import Search

POPULATION = 20  # both papers
LOCATION = 1.0  # LR: the swarm begins in [-1, 1]
FOOD_A = 3.1  # FR of paper A
SHRINK = 0.93  # of the steps per generation, in log10 coordinates: 3.1 decades become 0.002 in 100 generations

Step = Callable[[np.random.Generator, tuple[int, ...]], FloatArray]


def uniform_step(reach: float) -> Step:
    """Steps of U(-reach, reach), eq. (8)."""
    return lambda rng, shape: rng.uniform(-reach, reach, shape)


def normal_step(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Steps of N(0, 1): GFOA of paper B."""
    return rng.standard_normal(shape)


@dataclass(frozen=True)
class Rules:
    """What tells one kind of flies from another."""

    step: Step
    axes: int = 2  # coordinates of a fly for each parameter: X and Y; 3D-FOA has Z too
    perturbation: float = 0.0  # dw of IFOA, paper A, eq. (12); 0: plain FOA
    clamp: float = float("inf")  # of |X|, |Y|; not in the equations, one clamp stands in paper A's pseudo-code
    log10: bool = False  # location = log10 of the parameter, steps shrink, the box holds


FOA = Rules(uniform_step(FOOD_A))
FOA_3D = Rules(
    uniform_step(FOOD_A), axes=3
)  # paper A compares it and prints no equations: the literature's usual definition
GFOA = Rules(normal_step)
# Paper A: dw = 3.1, drawn from U(0, dw) per coordinate as printed, kept only if the generation gets better by it.
IFOA_A = Rules(uniform_step(FOOD_A), perturbation=FOOD_A)
IFOA_A_CLAMPED = replace(IFOA_A, clamp=LOCATION + FOOD_A)  # the one that is near Tables 2 and 5
FOA_B = Rules(uniform_step(1.0))  # paper B prints no FR


def in_log10(rules: Rules) -> Rules:
    """The same flies with the location as the logarithm of the parameter."""
    return replace(rules, axes=1, log10=True)


def fly(search: Search, rng: np.random.Generator, rules: Rules) -> None:
    """FOA (paper A, steps 1.1-1.6, eq. 7-11) and IFOA of paper A (steps 2.1-2.6, eq. 12), until the budget is spent.

    Not decided by the paper, and taken here: X, Y and S per parameter; the generation's best moves the swarm; a
    perturbation follows a generation that brought nothing and is taken back if it brings nothing either.
    """
    d = search.dimension
    home = rng.uniform(-LOCATION, LOCATION, (rules.axes, d))  # (7)
    best, came_to_nothing = np.inf, False
    for generation in count():
        size = SHRINK**generation if rules.log10 else 1.0
        before, tried = home, rules.perturbation > 0 and came_to_nothing
        if tried:
            home = home + size * rules.perturbation * rng.random(home.shape)
        flies = home + size * rules.step(rng, (POPULATION, rules.axes, d))  # (8)
        flies = _kept(search, np.clip(flies, -rules.clamp, rules.clamp), rules.log10)
        smell = search(_candidates(flies, rules.log10))
        i = int(np.argmin(smell))  # (10): the smell is an error, the least is best
        came_to_nothing = bool(smell[i] >= best)
        if came_to_nothing:
            home = before  # (12)
        else:
            best, home = float(smell[i]), flies[i]  # (11)


def fly_b(search: Search, rng: np.random.Generator, *, log10: bool = False, contract: bool = True) -> None:
    """IFOA of paper B, eq. (7)-(11), (21), (22), until the budget is spent.

    After more than two generations without a better one, flies leave the swarm by Student-t steps whose degrees of
    freedom are the generation (21); else each goes on from where it is, X += (X - X_axis) f. With the sign printed in
    (22), f in [-2, 0] contracts the swarm; `contract=False` takes the sign that most texts use, f in [0, 2].
    """
    d, axes = search.dimension, 1 if log10 else 2
    home = rng.uniform(-LOCATION, LOCATION, (axes, d))
    flies = _kept(search, home + rng.uniform(-1.0, 1.0, (POPULATION, axes, d)), log10)
    best, missed = np.inf, 0
    for generation in count(1):
        smell = search(_candidates(flies, log10))
        i = int(np.argmin(smell))
        if smell[i] < best:
            best, home, missed = float(smell[i]), flies[i], 0
        else:
            missed += 1
        if missed > 2:
            flies = home + rng.standard_t(generation, (POPULATION, axes, d))  # (21)
        else:
            f = (-2.0 if contract else 2.0) * rng.random((POPULATION, 1, 1))
            flies = flies + (flies - home) * f  # (22)
        flies = _kept(search, flies, log10)


def _candidates(flies: FloatArray, log10: bool) -> FloatArray:
    """(m, axes, d) -> (m, d): eq. (9), or the power of ten."""
    if log10:
        return np.asarray(10.0 ** flies[:, 0, :])
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sqrt((flies**2).sum(axis=1)))


def _kept(search: Search, flies: FloatArray, log10: bool) -> FloatArray:
    """In log10 coordinates flies stay in the box; the papers' flies know none."""
    if not log10:
        return flies
    return np.clip(flies, np.log10(search.low), np.log10(search.high))
