"""Paper B's search for the process noise Q = S of the fine alignment (eq. 36-39), with the optimisers as it sets them.

The same tuners over log10(S) show what a search that can set the scale wins. The right Q needs none: it is the
sensor's random walks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from estimation.arrays import FloatArray
from estimation.tuning import flies, particles
from estimation.tuning.optimisers import OPTIMISERS, run
from estimation.tuning.search import Found, Search

OURS = "ours"  # no search
BUDGET = 2000  # paper B: 100 generations of 20
RANGE_LOG10 = (-18.0, 1.0)  # of S, where it is searched over its logarithm


@dataclass(frozen=True)
class Tuner:
    """One way to search for S."""

    about: str
    run: Callable[[Search, np.random.Generator], None]
    low: float = 0.0  # the papers' flies know no box
    high: float = 1.0
    s_of: Callable[[FloatArray], FloatArray] = np.abs  # from what is searched; paper B's particles may be negative


def _swarm(search: Search, rng: np.random.Generator) -> None:
    particles.swarm(search, rng, particles.PAPER_B)


def _foa(search: Search, rng: np.random.Generator) -> None:
    flies.fly(search, rng, flies.FOA_B)


def _over_log10(name: str, about: str) -> Tuner:
    low, high = (10.0**end for end in RANGE_LOG10)
    return Tuner(about, OPTIMISERS[name].run, low, high)


TUNERS = {
    "pso": Tuner("particle swarm with paper B's settings: S in [-5, 5], its size counts", _swarm, -5.0, 5.0),
    "foa": Tuner("fruit flies, S = 1/Dist, eq. 7-11", _foa),
    "gfoa": Tuner("the same with normal steps", OPTIMISERS["gfoa"].run),
    "ifoa_b": Tuner("improved fruit flies of paper B, eq. 21-22", OPTIMISERS["ifoa_b"].run),
    "pso_log": Tuner("the swarm over log10(S)", _swarm, *RANGE_LOG10, lambda x: np.asarray(10.0**x)),
    "foa_log": _over_log10("foa_log", "the flies over log10(S)"),
    "gfoa_log": _over_log10("gfoa_log", "the same with normal steps"),
    "ifoa_b_log": _over_log10("ifoa_b_log", "improved flies of paper B over log10(S)"),
}


def search_s(fitness: Callable[[FloatArray], FloatArray], method: str, seed: int = 0, budget: int = BUDGET) -> Found:
    """The best S that a tuner finds.

    Args:
        fitness: of candidates S (m,), their mean squared misalignments (m,).
        method: a name of `TUNERS`.
        seed: of its random numbers.
        budget: evaluations at most.

    Returns:
        What was found; x is (S,), never negative.

    Raises:
        KeyError: an unknown method.
        ValueError: no candidate had a finite fitness.
    """
    tuner = TUNERS[method]
    search = Search(lambda x: fitness(tuner.s_of(x[:, 0])), np.array([tuner.low]), np.array([tuner.high]), budget)
    found = run(search, tuner.run, seed)
    return replace(found, x=tuner.s_of(found.x))
