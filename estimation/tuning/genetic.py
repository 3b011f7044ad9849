"""Genetic algorithm in the set-up of paper A, Table 3: the options of MATLAB's toolbox that it names, their defaults.

Named: population 20, initial population [2, 2], arithmetic crossover of 0.8, adaptive feasible mutation. Taken from the
toolbox's documentation: one elite, rank scaling 1/sqrt(rank), stochastic uniform selection, a mutation step that grows
by 4 after a better generation and shrinks by 4 after a worse one. With one population the migration fraction is idle.
"""

from __future__ import annotations

import numpy as np

from estimation.arrays import FloatArray
from estimation.tuning.search import Search

POPULATION = 20
CROSSED = round(0.8 * (POPULATION - 1))  # children of two parents; the rest of all but the elite are mutants
STEP_FACTOR = 4.0
LEAST_STEP, LARGEST_STEP = 1e-8, 1.0


def evolve(search: Search, rng: np.random.Generator, start: FloatArray | None = None) -> None:
    """Generations until the budget is spent. `start` (d,) is one of the first generation, the rest is uniform."""
    low, high = search.low, search.high
    people = rng.uniform(low, high, (POPULATION, search.dimension))
    if start is not None:
        people[0] = np.clip(start, low, high)
    fitness = search(people)
    step = LARGEST_STEP
    while len(fitness) == POPULATION:
        order = np.argsort(fitness, kind="stable")
        people, fitness = people[order], fitness[order]
        parents = _selected(rng, 2 * CROSSED + POPULATION - 1 - CROSSED)
        one, other = people[parents[:CROSSED]], people[parents[CROSSED : 2 * CROSSED]]
        share = rng.random((CROSSED, 1))
        crossed = share * one + (1.0 - share) * other
        mutants = people[parents[2 * CROSSED :]]
        mutants = mutants + step * (high - low) * _directions(rng, mutants.shape)
        children = np.vstack([crossed, np.clip(mutants, low, high)])
        values = search(children)
        if len(values) < len(children):
            return
        better = values.min() < fitness[0]
        step = min(step * STEP_FACTOR, LARGEST_STEP) if better else max(step / STEP_FACTOR, LEAST_STEP)
        people = np.vstack([people[:1], children])
        fitness = np.concatenate([fitness[:1], values])


def _selected(rng: np.random.Generator, n: int) -> FloatArray:
    """Indices of `n` parents: one pointer with even steps over shares of 1/sqrt(rank), shuffled."""
    share = 1.0 / np.sqrt(np.arange(1, POPULATION + 1))
    edges = np.cumsum(share / share.sum())
    pointers = (rng.random() + np.arange(n)) / n
    return rng.permutation(np.minimum(np.searchsorted(edges, pointers), POPULATION - 1))


def _directions(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Unit vectors, uniform over all directions."""
    raw = rng.standard_normal(shape)
    return np.asarray(raw / np.linalg.norm(raw, axis=1, keepdims=True))
