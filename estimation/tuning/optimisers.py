"""All optimisers by name, behind one call."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from estimation.arrays import FloatArray
from estimation.tuning import flies, genetic, local, particles, peers
from estimation.tuning.search import Bounds, Found, Search, Spent, box

BUDGET = 2020  # paper A: 20 flies at the start and in each of 100 generations
AUTO = "auto"


@dataclass(frozen=True)
class Optimiser:
    """One way to search, until it is done or the budget is spent."""

    about: str
    run: Callable[[Search, np.random.Generator], None]
    positive: bool = False  # its candidates are positive numbers of free size; it knows no box
    log10: bool = False  # it walks over the parameter's logarithm: the box must be positive


def _auto(search: Search, rng: np.random.Generator) -> None:
    if search.dimension == 1:
        local.line(search)
    else:
        local.many_starts(search, rng)


def _fly(about: str, rules: flies.Rules) -> Optimiser:
    return Optimiser(
        about, lambda search, rng: flies.fly(search, rng, rules), positive=not rules.log10, log10=rules.log10
    )


OPTIMISERS = {
    AUTO: Optimiser("grid for one parameter, multistart for several", _auto),
    "grid": Optimiser("one parameter: 17 points, then Brent's bounded search", lambda search, _rng: local.line(search)),
    "multistart": Optimiser("L-BFGS-B from a low-discrepancy sequence, then Nelder-Mead", local.many_starts),
    "foa": _fly("fruit flies, paper A eq. 7-11", flies.FOA),
    "foa3d": _fly("fruit flies with a third coordinate, named by paper A", flies.FOA_3D),
    "gfoa": _fly("fruit flies with normal steps, paper B", flies.GFOA),
    "ifoa_a": _fly("improved fruit flies of paper A: a perturbation, eq. 12", flies.IFOA_A),
    "ifoa_a_clamped": _fly("the same, coordinates clamped at 4.1", flies.IFOA_A_CLAMPED),
    "ifoa_b": Optimiser(
        "improved fruit flies of paper B: Student-t and frequency path, eq. 21-22", flies.fly_b, positive=True
    ),
    "foa_log": _fly("fruit flies over the logarithm of the parameter", flies.in_log10(flies.FOA)),
    "gfoa_log": _fly("the same with normal steps", flies.in_log10(flies.GFOA)),
    "ifoa_a_log": _fly("improved fruit flies of paper A over the logarithm", flies.in_log10(flies.IFOA_A)),
    "ifoa_b_log": Optimiser(
        "improved fruit flies of paper B over the logarithm",
        lambda search, rng: flies.fly_b(search, rng, log10=True),
        log10=True,
    ),
    "pso": Optimiser("particle swarm with paper A's settings", particles.swarm),
    "ga": Optimiser("genetic algorithm with paper A's settings", genetic.evolve),
    "de": Optimiser("scipy's differential evolution, its defaults", peers.differential_evolution),
    "nelder_mead": Optimiser("scipy's Nelder-Mead from a random point", peers.nelder_mead),
    "cma": Optimiser("CMA-ES of the package cma (extra `tuning`)", peers.cma_es),
}


def minimize(
    fun: Callable[[FloatArray], float | FloatArray],
    bounds: Bounds,
    method: str = AUTO,
    budget: int = BUDGET,
    seed: int = 0,
    *,
    vectorised: bool = False,
) -> Found:
    """Least value of `fun` over a box.

    Args:
        fun: of x (d,), a float; with `vectorised`, of candidates (m, d), their values (m,).
        bounds: (low, high) of each parameter. The papers' flies know no box; their candidates are positive.
        method: a name of `OPTIMISERS`.
        budget: evaluations at most.
        seed: of the random numbers; the same seed gives the same result.

    Returns:
        x (d,), value, evaluations, history of the best, count of values that were no finite number.

    Raises:
        ValueError: an unknown method, a budget below 1, bounds that are no box, or nothing finite found.
    """
    low, high = box(bounds)
    if method not in OPTIMISERS:
        raise ValueError(f"the method {method} is unknown; there are {', '.join(OPTIMISERS)}")
    optimiser = OPTIMISERS[method]
    if budget < 1:
        raise ValueError(f"a budget of {budget} evaluations finds nothing; it must be 1 or more")
    if optimiser.log10 and (low <= 0).any():
        raise ValueError(f"the method {method} walks over logarithms: the bounds must be positive")
    if method == "grid" and len(low) != 1:
        raise ValueError(f"the method grid is for one parameter, not {len(low)}")

    def values(candidates: FloatArray) -> FloatArray:
        if vectorised:
            return np.asarray(fun(candidates), dtype=np.float64)
        return np.array([float(fun(candidate)) for candidate in candidates])

    return run(Search(values, low, high, budget), optimiser.run, seed)


def run(search: Search, optimiser: Callable[[Search, np.random.Generator], None], seed: int) -> Found:
    """Let it search until it is done or the budget is spent. Raises ValueError if nothing is finite."""
    with suppress(Spent), np.errstate(invalid="ignore"):  # differences of infinite values
        optimiser(search, np.random.default_rng(seed))
    return search.found()
