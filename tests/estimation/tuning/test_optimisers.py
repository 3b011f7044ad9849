"""Every optimiser behind the one call: budget, seed, box; and the flies' laws, worked out by hand or by others."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import ks_2samp

from estimation.arrays import FloatArray
from estimation.tuning import flies, genetic, particles
from estimation.tuning.functions import FUNCTIONS, box_of, shifted
from estimation.tuning.optimisers import OPTIMISERS, minimize, run
from estimation.tuning.search import Search

OTHERS = json.loads((Path(__file__).parent / "data" / "other_libraries.json").read_text())["errors"]
IN_A_BOX = [name for name, one in OPTIMISERS.items() if not one.positive and not one.log10 and name != "grid"]


def bowl(x: FloatArray) -> float:
    return float(((x - 0.7) ** 2).sum())


@pytest.mark.parametrize("method", OPTIMISERS)
def test_same_seed_same_result_and_never_more_than_the_budget(method: str) -> None:
    calls: list[FloatArray] = []

    def counted(x: FloatArray) -> float:
        calls.append(x)
        return bowl(x)

    bounds = [(0.1, 2.0)] * (1 if method == "grid" else 2)
    first = minimize(counted, bounds, method, budget=75, seed=4)
    assert first.evaluations == len(calls) <= 75
    again = minimize(bowl, bounds, method, budget=75, seed=4)
    np.testing.assert_array_equal(first.x, again.x)
    assert first.history == again.history
    assert first.value == bowl(first.x) == min(bowl(x) for x in calls)
    assert [value for _, value in first.history] == sorted((value for _, value in first.history), reverse=True)


@pytest.mark.parametrize("method", OPTIMISERS)
@pytest.mark.parametrize("budget", [1, 7, 21])
def test_a_tiny_budget_gives_the_best_of_it(method: str, budget: int) -> None:
    found = minimize(bowl, [(0.1, 2.0)] * (1 if method == "grid" else 2), method, budget=budget)
    assert 1 <= found.evaluations <= budget
    assert np.isfinite(found.value)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    method=st.sampled_from([name for name in IN_A_BOX if name != "cma"]),
    seed=st.integers(0, 1000),
    low=st.floats(-1e3, 1e3),
    width=st.floats(1e-3, 1e3),
)
def test_candidates_stay_in_the_box(method: str, seed: int, low: float, width: float) -> None:
    seen: list[FloatArray] = []

    def noted(candidates: FloatArray) -> FloatArray:
        seen.append(candidates)
        return np.asarray((candidates**2).sum(axis=1))

    minimize(noted, [(low, low + width)] * 2, method, budget=60, seed=seed, vectorised=True)
    all_seen = np.concatenate(seen)
    slack = 1e-9 * max(abs(low), width)
    assert all_seen.min() >= low - slack
    assert all_seen.max() <= low + width + slack


def test_misuse_is_told_in_one_sentence() -> None:
    for arguments, words in (
        ({"bounds": [(2.0, 1.0)]}, "limits of parameter 1 are reversed or empty: 2 to 1"),
        ({"bounds": [(0.0, 1.0), (3.0, 3.0)]}, "limits of parameter 2"),
        ({"bounds": [(0.0, float("inf"))]}, "finite"),
        ({"bounds": []}, "pairs"),
        ({"bounds": [(0.0, 1.0)], "budget": 0}, "a budget of 0 evaluations"),
        ({"bounds": [(0.0, 1.0)], "method": "ant"}, "the method ant is unknown"),
        ({"bounds": [(0.0, 1.0)], "method": "foa_log"}, "the bounds must be positive"),
        ({"bounds": [(0.0, 1.0)] * 2, "method": "grid"}, "for one parameter, not 2"),
    ):
        with pytest.raises(ValueError, match=words):
            minimize(bowl, **arguments)


@pytest.mark.parametrize("method", [name for name in OPTIMISERS if name not in ("grid", "cma")])
def test_values_that_are_no_number_are_counted_and_never_chosen(method: str) -> None:
    def holed(x: FloatArray) -> float:
        return float("nan") if x[0] > 1.9 else bowl(x)

    found = minimize(holed, [(0.1, 2.0)] * 2, method, budget=200, seed=1)
    assert np.isfinite(found.value)
    assert found.x[0] <= 1.9
    with pytest.raises(ValueError, match="no finite value at any of"):
        minimize(lambda _: float("nan"), [(0.1, 2.0)] * 2, method, budget=40)


# --- the flies --------------------------------------------------------------------------------------------------------


def test_foa_by_hand_fly_after_fly() -> None:
    """The six steps of papers A and B as loops over scalars, on the same random numbers."""
    function = FUNCTIONS["griewank"]
    rng = np.random.default_rng(9)
    home = rng.uniform(-1, 1, (2, 2))  # X_axis, Y_axis of both parameters
    best, best_at = float("inf"), np.zeros(2)
    for _ in range(30):
        steps = rng.uniform(-3.1, 3.1, (20, 2, 2))
        smelt = []
        for fly in range(20):
            x = [home[0][j] + steps[fly][0][j] for j in range(2)]
            y = [home[1][j] + steps[fly][1][j] for j in range(2)]
            s = [1.0 / (x[j] * x[j] + y[j] * y[j]) ** 0.5 for j in range(2)]
            smelt.append((float(function.of(np.array([s]))[0]), fly, s, [x, y]))
        smell, _, s, place = min(smelt)
        if smell < best:
            best, best_at, home = smell, np.array(s), np.array(place)
    found = minimize(function.of, [(-5, 5)] * 2, "foa", budget=600, seed=9, vectorised=True)
    assert found.value == pytest.approx(best, rel=1e-12)
    np.testing.assert_allclose(found.x, best_at, rtol=1e-12)


def test_perturbation_is_taken_back_when_it_brings_nothing() -> None:
    """On a plateau nothing is ever better: the swarm leaves its first best only for the perturbed try, eq. (12)."""
    seen: list[FloatArray] = []

    def plateau(candidates: FloatArray) -> FloatArray:
        seen.append(candidates)
        return np.ones(len(candidates))

    rules = flies.Rules(lambda _rng, shape: np.zeros(shape), perturbation=3.1)
    run(Search(plateau, np.zeros(2), np.ones(2), 20 * 6), lambda search, rng: flies.fly(search, rng, rules), 2)
    generations = [candidates[0] for candidates in seen]
    still = generations[0]
    np.testing.assert_array_equal(generations[1], still)
    for perturbed in generations[2:]:
        assert (perturbed != still).all()
    axes = 1.0 / np.array(generations[2:])
    assert len(np.unique(axes.round(12), axis=0)) == len(axes)  # each from the same place, by a fresh draw


def test_frequency_path_contracts_and_t_path_leaps() -> None:
    """Eq. (22) with the printed sign never leaves the hull of fly and swarm; (21) does, after three dry generations."""
    seen: list[FloatArray] = []

    def rising(candidates: FloatArray) -> FloatArray:
        seen.append(candidates)
        return np.arange(len(candidates), dtype=np.float64) + 100.0 * len(
            seen
        )  # each generation is worse than the last

    run(Search(rising, np.zeros(1), np.ones(1), 20 * 40), flies.fly_b, 3)
    radii = [1.0 / candidates[:, 0] for candidates in seen]
    spread = [float(np.ptp(radius)) for radius in radii]
    assert spread[1] < spread[0]
    assert spread[2] < spread[1]
    assert max(spread[4:]) > 2.0 * spread[0]


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000))
def test_candidates_of_the_papers_flies_are_positive(seed: int) -> None:
    for name in ("foa", "foa3d", "gfoa", "ifoa_a", "ifoa_a_clamped", "ifoa_b"):
        lowest: list[float] = []

        def noted(candidates: FloatArray, lowest: list[float] = lowest) -> FloatArray:
            lowest.append(float(candidates.min()))
            return np.asarray(candidates.sum(axis=1))

        minimize(noted, [(-1, 1)] * 2, name, budget=100, seed=seed, vectorised=True)
        assert min(lowest) > 0
    clamped = minimize(lambda x: float(x.sum()), [(-1, 1)] * 2, "ifoa_a_clamped", budget=2020, seed=seed)
    assert clamped.x.min() >= 1 / (4.1 * 2**0.5) - 1e-12  # the floor that Table 5's Q = 0.1758 stands on


# --- against other libraries ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FUNCTIONS)
def test_particle_swarm_errs_as_pyswarms_does(name: str) -> None:
    """Kolmogorov and Smirnov on 50 seeds of each; the law is the same, the random numbers are not."""
    function = FUNCTIONS[name]
    bounds = box_of(function, is_shifted=False)
    low, high = np.array(bounds).T
    errors = [
        run(Search(function.of, low, high, 2020), particles.swarm, seed).value - function.optimum for seed in range(50)
    ]
    theirs = np.array(OTHERS[f"pyswarms {name}"])
    # To the digits stored, so that equal minima are equal; below 1e-13 is rounding.
    ours, theirs = (np.array([float(f"{max(error, 1e-13):.4g}") for error in one]) for one in (errors, theirs))
    assert ks_2samp(ours, theirs).pvalue > 0.001


@pytest.mark.parametrize("name", FUNCTIONS)
def test_genetic_algorithm_is_no_worse_than_mealpys(name: str) -> None:
    """Other operators, the same population and crossover share: at the median ours must not lose to it by 3 x."""
    function = FUNCTIONS[name]
    low, high = np.array(box_of(function, is_shifted=False)).T
    errors = [
        run(Search(function.of, low, high, 2020), genetic.evolve, seed).value - function.optimum for seed in range(30)
    ]
    if name == "test_tube_holder":  # arithmetic crossover keeps between the parents: it often stays in a side valley
        assert np.median(errors) < 0.05
    else:
        assert np.median(errors) < 3 * np.median(OTHERS[f"mealpy_ga {name}"])


@pytest.mark.parametrize("name", FUNCTIONS)
def test_optimum_is_where_the_table_says(name: str) -> None:
    function = FUNCTIONS[name]
    at = float(function.of(np.array([function.at]))[0])
    assert at == pytest.approx(function.optimum, abs=1e-9)
    near = np.array(function.at) + np.random.default_rng(1).normal(0, 0.3, (2000, function.dimension))
    assert function.of(near).min() >= function.optimum - 1e-12


@pytest.mark.parametrize("name", FUNCTIONS)
def test_own_optimiser_solves_shifted_functions_and_flies_do_not(name: str) -> None:
    solved = {"multistart": 0, "ifoa_b": 0}
    for method in solved:
        for seed in range(10):
            function = shifted(FUNCTIONS[name], seed)
            bounds = box_of(function, is_shifted=True)
            found = minimize(function.of, bounds, method, 2000, seed, vectorised=True)
            solved[method] += found.value - function.optimum < 1e-6
    assert solved["multistart"] >= 9
    assert solved["ifoa_b"] <= 5
