"""Particle swarm optimiser with the settings of papers A and B; the law itself neither prints: the standard one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.tuning.search import Search

PARTICLES = 20
SPEED_PER_WIDTH = 0.1  # velocity range [-1, 1] for a population range [-5, 5]


@dataclass(frozen=True)
class Pull:
    """Inertia, and acceleration towards the particle's own best and the swarm's."""

    inertia: float
    acceleration: float


PAPER_A = Pull(0.729, 1.49445)
PAPER_B = Pull(0.65, 1.49)


def swarm(search: Search, rng: np.random.Generator, pull: Pull = PAPER_A) -> None:
    """v := w v + c r1 (own best - x) + c r2 (swarm's best - x), both clamped, until the budget is spent."""
    low, high = search.low, search.high
    fastest = SPEED_PER_WIDTH * (high - low)
    x = rng.uniform(low, high, (PARTICLES, search.dimension))
    v = rng.uniform(-fastest, fastest, x.shape)
    value = search(x)
    if len(value) < PARTICLES:
        return
    own_x, own = x.copy(), value
    while True:
        toward_own, toward_best = rng.random(x.shape), rng.random(x.shape)
        v = pull.inertia * v + pull.acceleration * (
            toward_own * (own_x - x) + toward_best * (own_x[int(np.argmin(own))] - x)
        )
        v = np.clip(v, -fastest, fastest)
        x = np.clip(x + v, low, high)
        value = search(x)
        better = np.zeros(PARTICLES, dtype=bool)
        better[: len(value)] = value < own[: len(value)]
        own_x[better] = x[better]
        own[better] = value[better[: len(value)]]
