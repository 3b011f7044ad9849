"""All tuners on problems whose answer is known: paper A's artificial signal, paper B's six functions."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from daemon.offline.parallel import parallel
from estimation.tuning import flies, particles
from estimation.tuning.artificial import ARTIFICIAL, observed
from estimation.tuning.functions import FUNCTIONS, box_of, shifted
from estimation.tuning.optimisers import OPTIMISERS, run
from estimation.tuning.search import Search
from estimation.tuning.two_state_tuning import fit, tune

Kind = Literal["artificial", "functions"]
BUDGET = 2020  # paper A; paper B's 2,000 are the first hundred generations of it
SUCCESS = 1e-6  # a function's error below it
GRID_STEP = 0.02  # decades of q/r, for the true optimum
ML = "auto ml"  # the default objective: its tuner sees no truth
TRUE = "true Q, R"
ON_ARTIFICIAL = (
    *("auto", ML, TRUE, "de", "nelder_mead", "foa", "foa3d", "ifoa_a", "ifoa_a_clamped", "gfoa", "ifoa_b"),
    *("foa_log", "ifoa_a_log", "pso", "ga"),
)
ON_FUNCTIONS = ("multistart", "de", "nelder_mead", "pso", "foa", "gfoa", "ifoa_b")
# Paper A, Table 2: MSE; paper B, Table 1: best value.
PRINTED_A = {"pso": 0.39747, "ga": 0.26777, "foa": 0.022869, "foa3d": 0.022089, "ifoa_a": 0.020527}
PRINTED_B = {
    "ackley": {"pso": 0.440788, "foa": 0.049512, "gfoa": 0.017546, "ifoa_b": 7.11e-15},
    "griewank": {"pso": 0.001394, "foa": 9.29e-5, "gfoa": 2.43e-5, "ifoa_b": 3.33e-16},
    "zettl": {"pso": 0.013575, "foa": 0.002592, "gfoa": 0.001333, "ifoa_b": 3.07e-11},
    "test_tube_holder": {"pso": -10.843774, "foa": -10.700662, "gfoa": -10.766711, "ifoa_b": -10.872299},
    "helical_valley": {"pso": 6.926416, "foa": 0.739871, "gfoa": 0.679324, "ifoa_b": 0.389474},
    "wood": {"pso": 1.777238, "foa": 0.852053, "gfoa": 1.414687, "ifoa_b": 1.61e-4},
}


@dataclass(frozen=True)
class Row:
    """One method on one problem with one seed."""

    problem: str
    variant: str  # form of Q, or original | shifted
    method: str
    seed: int
    x: list[float]  # q, r; or the function's arguments
    value: float
    optimum: float
    evaluations: int
    seconds: float
    history: list[tuple[int, float]] = field(repr=False)

    @property
    def excess(self) -> float:
        """Over the true optimum: relative for the mean squared error, absolute for a function's value."""
        above = self.value - self.optimum
        return above / self.optimum if self.problem in ARTIFICIAL else above

    def told(self, kind: Kind) -> dict[str, Any]:
        """The row as the JSON output has it."""
        told = asdict(self)
        del told["history"]
        name = told.pop("problem")
        x = told.pop("x")
        where = {"q": x[0], "r": x[1]} if kind == "artificial" else {"x": x}
        return {"scenario" if kind == "artificial" else "function": name} | told | where | {"excess": self.excess}


def _cases(kind: Kind, seeds: Sequence[int], methods: Sequence[str]) -> list[tuple[str, str, str, int]]:
    problems = [(name, "") for name in ARTIFICIAL]
    if kind == "functions":
        problems = [(name, variant) for name in FUNCTIONS for variant in ("original", "shifted")]
    return [(name, variant, method, seed) for name, variant in problems for method in methods for seed in seeds]


def count(kind: Kind, seeds: Sequence[int], methods: Sequence[str]) -> int:
    """How many runs that is."""
    return len(_cases(kind, seeds, methods))


def benchmark(
    kind: Kind,
    seeds: Sequence[int],
    methods: Sequence[str],
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> list[Row]:
    """A row for every problem, method and seed; the same but for the times whatever `jobs` is."""
    cases = _cases(kind, seeds, methods)
    done: dict[tuple[str, str, str, int], Row] = {}
    for case, row in parallel(_worked, cases, jobs):
        done[case] = row
        if progress is not None:
            progress(len(done))
    return [done[case] for case in cases]


def _worked(case: tuple[str, str, str, int]) -> tuple[tuple[str, str, str, int], Row]:
    name, variant, method, seed = case
    return case, _artificial(name, method, seed) if name in ARTIFICIAL else _function(name, variant, method, seed)


def _artificial(name: str, method: str, seed: int) -> Row:
    case = ARTIFICIAL[name]
    motion = observed(case, seed)
    begun = time.perf_counter()
    if method == TRUE:
        q, r, evaluations, history = case.var_w, case.var_v, 0, []
    else:
        tuned = tune([motion], case.form, method.split()[0], "ml" if method == ML else "truth", seed, BUDGET)
        q, r, evaluations, history = tuned.q, tuned.r, tuned.evaluations, tuned.history
    seconds = time.perf_counter() - begun
    mse = float(fit([motion], np.array([q / r])).mse[0])
    return Row(name, case.form, method, seed, [q, r], mse, optimum_of(name, seed), evaluations, seconds, history)


@lru_cache
def optimum_of(name: str, seed: int) -> float:
    """Least mean squared error over q/r, by a dense grid and a bounded search around its best point."""
    from scipy.optimize import minimize_scalar

    motion = observed(ARTIFICIAL[name], seed)
    grid = np.arange(-14.0, 14.0 + GRID_STEP, GRID_STEP)
    best = float(grid[int(np.argmin(fit([motion], 10.0**grid).mse))])
    found = minimize_scalar(
        lambda x: float(fit([motion], np.array([10.0**x])).mse[0]),
        bounds=(best - GRID_STEP, best + GRID_STEP),
        method="bounded",
        options={"xatol": 1e-9},
    )
    return float(found.fun)


def _function(name: str, variant: str, method: str, seed: int) -> Row:
    moved = variant == "shifted"
    function = shifted(FUNCTIONS[name], seed) if moved else FUNCTIONS[name]
    # Paper B has settings of its own for these two.
    ways: dict[str, Callable[[Search, np.random.Generator], None]] = {
        "foa": lambda search, rng: flies.fly(search, rng, flies.FOA_B),
        "pso": lambda search, rng: particles.swarm(search, rng, particles.PAPER_B),
    }
    low, high = np.array(box_of(function, is_shifted=moved)).T
    begun = time.perf_counter()
    found = run(Search(function.of, low, high, BUDGET), ways.get(method, OPTIMISERS[method].run), seed)
    seconds = time.perf_counter() - begun
    x = [float(value) for value in found.x]
    return Row(name, variant, method, seed, x, found.value, function.optimum, found.evaluations, seconds, found.history)


def summarise(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Over the seeds, for each problem, variant and method."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.problem, row.variant, row.method), []).append(row)
    summaries = []
    for (problem, variant, method), group in groups.items():
        excess = np.array([row.excess for row in group])
        printed = (PRINTED_A if problem in ARTIFICIAL else PRINTED_B[problem]).get(method)
        summaries.append(
            {
                "problem": problem,
                "variant": variant,
                "method": method,
                "runs": len(group),
                "value_median": float(np.median([row.value for row in group])),
                "excess_median": float(np.median(excess)),
                "excess_p95": float(np.percentile(excess, 95)),
                "solved": float(np.mean(excess < SUCCESS)),
                "evaluations_median": float(np.median([row.evaluations for row in group])),
                "seconds_median": float(np.median([row.seconds for row in group])),
                "printed": printed if problem in (*FUNCTIONS, "AS-1") and variant != "shifted" else None,
            }
        )
    return summaries
