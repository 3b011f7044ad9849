"""Process noises of the fine alignment by candidates: a covariance by another route, the bound, paper B's search."""

from __future__ import annotations

from math import radians
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from daemon.offline.alignment.grades import load_grades
from estimation.alignment.attitude import misalignment
from estimation.alignment.candidates import Records, each_step
from estimation.alignment.fine import FineAlignment, error_dynamics
from estimation.alignment.scenarios import ALIGNMENTS, STEP_S, Alignment, Resting
from estimation.alignment.search import OURS, TUNERS, search_s
from estimation.arrays import FloatArray

GRADES = load_grades()
RUNS = 60
S = 10.0 ** np.array([-16.0, -13.0, -11.0, -8.0, -2.5, -0.75])
REACHED_BY_FLIES = S > 1e-3  # S = 1/Dist: 0.01 after a hundred generations


def records_of(case: Alignment, runs: int, seed: int = 1) -> Records:
    return Records(Resting(case, GRADES[case.grade], runs, seed))


def last(records: Records, run: NDArray[Any], noise: FloatArray) -> FineAlignment:
    for fine in records.align(run.astype(np.intp), noise):  # noqa: B007  the last one is asked for
        pass
    return fine


# --- the filter -------------------------------------------------------------------------------------------------------


def covariance_by_the_book(case: Alignment, noise: FloatArray) -> FloatArray:
    """Eq. (2)-(6) step by step, transition by the matrix exponential and noise by Van Loan's."""
    f, grade, prior = error_dynamics(case.place), GRADES[case.grade], case.prior
    continuous = np.diag([noise[0]] * 2 + [noise[1]] * 3 + [0.0] * 5)
    block = expm(np.block([[-f, continuous], [np.zeros((10, 10)), f.T]]) * STEP_S)
    phi = block[10:, 10:].T
    q, r = phi @ block[:10, 10:], np.eye(2) * (case.velocity_mm_s * 1e-3) ** 2
    level = [prior.velocity] * 2 + [prior.level] * 2 + [prior.heading]
    p = np.diag(np.array(level + [grade.accel_bias] * 2 + [grade.gyro_bias] * 3) ** 2)
    for _ in range(round(case.duration_s / STEP_S)):
        p = phi @ p @ phi.T + q
        p = p - p[:, :2] @ np.linalg.solve(p[:2, :2] + r, p[:2])
    return np.asarray(np.sqrt(np.diag(p)[2:5]))


def test_covariances_of_candidates_are_those_of_the_book() -> None:
    records = records_of(ALIGNMENTS["AL-2"], 1)
    noise = np.vstack([records.ours, each_step(np.array([1e-12, 1e-9, 1e-6])), [1e-6, 1e-10]])
    fine = last(records, np.zeros(len(noise)), noise)
    assert fine.sigma.shape == (len(noise), 3)
    for i, one in enumerate(noise):
        # Within a step noise spreads by a trapezium here: it shows where there is far too much of it.
        rtol = 2e-3 if i == 0 else 0.03
        np.testing.assert_allclose(fine.sigma[i], covariance_by_the_book(ALIGNMENTS["AL-2"], one), rtol=rtol)


def test_many_candidates_at_once_are_one_after_the_other() -> None:
    records = records_of(ALIGNMENTS["AL-8"], 3)
    run, noise = np.array([2, 0, 1, 2]), each_step(np.array([1e-10, 1e-4, 0.2, 1e-13]))
    together = last(records, run, noise)
    for i in range(len(run)):
        alone = last(records, run[i : i + 1], noise[i])  # one pair for all runs: the covariance is shared
        assert alone.p.shape == (10, 10)
        np.testing.assert_allclose(alone.attitude[0], together.attitude[i], atol=1e-12)
        np.testing.assert_allclose(alone.sigma, together.sigma[i], rtol=1e-9)


def test_without_a_noise_it_is_the_grades() -> None:
    case = ALIGNMENTS["AL-8"]
    records = records_of(case, 2)
    given = last(records, np.arange(2), records.ours)
    plain = FineAlignment(case.place, GRADES[case.grade], records.sensors.begun, case.prior, case.velocity_mm_s * 1e-3)
    for turn, push, moved in records.increments:
        plain.step(turn, push, STEP_S, moved)
    np.testing.assert_array_equal(given.attitude, plain.attitude)
    np.testing.assert_array_equal(given.p, plain.p)


def test_intervals_of_different_lengths_may_follow_each_other() -> None:
    """A long interval is two short ones, to the order of what is left out."""
    case = ALIGNMENTS["AL-8"]
    place, still = case.place, np.zeros(3)
    push = np.array([0.0, 0.0, place.gravity_m_s2])
    twice, mixed = (
        FineAlignment(place, GRADES[case.grade], np.eye(3), case.prior, 1e9, np.array([1e-6, 1e-8])) for _ in range(2)
    )
    for dt_s in (0.1, 0.1, 0.1, 0.1, 0.1):
        twice.step(still, push * dt_s, dt_s)
    for dt_s in (0.1, 0.2, 0.2):
        mixed.step(still, push * dt_s, dt_s)
    np.testing.assert_allclose(mixed.sigma, twice.sigma, rtol=1e-3)


# --- what a process noise can win -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ends() -> tuple[FloatArray, FloatArray, FloatArray]:
    """AL-2 (50 s): rms errors and claimed sigmas of each S (m, 3), and the bound (3,) in rad."""
    records = records_of(ALIGNMENTS["AL-2"], RUNS)
    fine = last(records, np.tile(np.arange(RUNS), len(S)), each_step(np.repeat(S, RUNS)))
    errors = misalignment(fine.attitude, np.tile(records.sensors.true, (len(S), 1, 1))).reshape(len(S), RUNS, 3)
    bound = last(records, np.arange(RUNS), records.ours).sigma
    return np.sqrt((errors**2).mean(axis=1)), fine.sigma.reshape(len(S), RUNS, 3)[:, 0], bound


def test_no_scalar_beats_the_bound_and_small_ones_reach_it(ends: tuple[FloatArray, FloatArray, FloatArray]) -> None:
    rms, _, bound = ends
    spread = 1 / np.sqrt(2 * RUNS)
    assert (rms >= (1 - 3 * spread) * bound).all()
    assert (rms[:2] <= (1 + 3 * spread) * bound).all()
    assert rms[2, 2] > 3 * bound[2]  # two decades more, and yaw is lost


def test_what_flies_can_reach_leaves_yaw_at_its_prior(ends: tuple[FloatArray, FloatArray, FloatArray]) -> None:
    rms, claimed, bound = ends
    prior = radians(ALIGNMENTS["AL-2"].heading_deg)
    spread = 3 / np.sqrt(2 * RUNS)
    assert bound[2] < 0.15 * prior
    assert rms[REACHED_BY_FLIES, 2] == pytest.approx(prior, rel=spread)
    assert (rms[REACHED_BY_FLIES, :2] > 8 * bound[:2]).all()
    assert (claimed[REACHED_BY_FLIES] > 30 * rms[REACHED_BY_FLIES]).all()  # and says nothing of it


# --- the search -------------------------------------------------------------------------------------------------------


def found(records: Records, method: str, seed: int, budget: int) -> float:
    return float(search_s(lambda s: records.fitness(np.zeros(len(s), dtype=np.intp), s), method, seed, budget).x[0])


def test_flies_miss_the_scale_that_they_find_over_the_logarithm() -> None:
    case = Alignment("navigation", 40, 30, 0.1, 1, 1)
    records = records_of(case, 1, seed=2)
    s = {method: found(records, method, 5, 200) for method in ("foa", "foa_log")}
    assert s["foa"] > 1e-3
    assert s["foa_log"] < 1e-6
    fine = last(records, np.zeros(2), each_step(np.array(list(s.values()))))
    true, begun = records.sensors.true, records.sensors.begun
    off = np.abs(misalignment(fine.attitude, true)[:, 2])
    bound = last(records, np.zeros(1), records.ours).sigma[2]
    assert off[0] == pytest.approx(abs(misalignment(begun, true)[0, 2]), rel=0.1)
    assert off[1] < 3 * bound


@pytest.mark.parametrize("method", TUNERS)
def test_a_search_is_the_same_for_the_same_seed_and_s_is_never_negative(method: str) -> None:
    records = records_of(Alignment("paper_b", 40, 1, 0.1, 1, 1), 1)
    first, second, other = (found(records, method, seed, 60) for seed in (3, 3, 4))
    assert first == second
    assert first != other or method.endswith("_log")  # these may both come to the range's end
    assert 0 <= first < np.inf


def test_the_right_noise_is_no_tuner() -> None:
    assert OURS not in TUNERS


def test_a_candidate_beyond_all_bounds_has_no_finite_fitness() -> None:
    records = records_of(Alignment("paper_b", 40, 1, 0.1, 1, 1), 1)
    values = records.fitness(np.zeros(3, dtype=np.intp), np.array([1e-12, np.inf, np.nan]))
    assert np.isfinite(values).tolist() == [True, False, False]
    assert 0 < values[0] < 1e-3
