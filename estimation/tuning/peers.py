"""Optimisers of other hands behind the same interface: scipy's, and CMA-ES by `cma` (an extra)."""

from __future__ import annotations

import numpy as np

from estimation.arrays import FloatArray
from estimation.tuning.search import Search


def differential_evolution(search: Search, rng: np.random.Generator) -> None:
    """Scipy's, with its defaults, in the box."""
    from scipy.optimize import Bounds
    from scipy.optimize import differential_evolution as scipy_de

    scipy_de(search.one, Bounds(search.low, search.high), rng=rng)


def nelder_mead(search: Search, rng: np.random.Generator) -> None:
    """Scipy's, from a random point of the box."""
    from scipy.optimize import Bounds, minimize

    minimize(
        search.one,
        rng.uniform(search.low, search.high),
        method="Nelder-Mead",
        bounds=Bounds(search.low, search.high),
        options={"maxfev": search.left},
    )


def cma_es(search: Search, rng: np.random.Generator) -> None:
    """CMA-ES from the middle of the box, in units of its width. Raises ValueError where `cma` is not installed."""
    try:
        import cma
    except ImportError:
        raise ValueError("the method cma needs the package cma, of the extra `tuning`") from None
    width, d = search.high - search.low, search.dimension
    walked = max(d, 2)  # it is not made for one dimension: a second one that does nothing

    def values(units: list[FloatArray]) -> list[float]:
        return [float(v) for v in search(search.low + width * np.clip(np.array(units)[:, :d], 0.0, 1.0))]

    options = {"bounds": [0, 1], "seed": int(rng.integers(1, 2**31)), "verbose": -9, "maxfevals": search.left}
    strategy = cma.CMAEvolutionStrategy(np.full(walked, 0.5), 0.25, options)
    while not strategy.stop():
        asked = strategy.ask()
        told = values(asked)
        if len(told) < len(asked):
            return
        strategy.tell(asked, told)
