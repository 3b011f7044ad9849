"""Paper A's filter over a record: against matrices, dense covariances, Riccati's equation and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are
from scipy.stats import multivariate_normal

from estimation.arrays import FloatArray
from estimation.tuning import compiled
from estimation.tuning.artificial import ARTIFICIAL, observed, signal
from estimation.tuning.observed import FORMS, Form, Observed, observed_at_every_step, observed_by_readings
from estimation.tuning.two_state_pass import FEW, estimate, exact, innovations, scan, steady_gain

H = np.array([[1.0, 0.0]])


def by_matrices(
    t_s: FloatArray, a: FloatArray, seen_s: FloatArray, seen: FloatArray, form: Form, q: float
) -> FloatArray:
    """Eq. (1)-(6) as they stand, sample by sample, R = 1: posterior positions at the readings."""
    x, p = np.zeros((2, 1)), np.zeros((2, 2))
    told, next_reading, before = [], 0, t_s[0]
    for t, u in zip(t_s, a, strict=True):
        dt = t - before
        before = t
        A, B = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[dt * dt / 2], [dt]])
        x = A @ x + B * u
        p = A @ p @ A.T + (q * B @ B.T if form == "BqB" else q * np.eye(2))
        if next_reading < len(seen_s) and seen_s[next_reading] <= t:
            s = float((H @ p @ H.T)[0, 0]) + 1.0
            k = p @ H.T / s
            x = x + k * (seen[next_reading] - x[0, 0])
            p = (np.eye(2) - k @ H) @ p
            told.append(x[0, 0])
            next_reading += 1
    return np.array(told)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), log_q=st.floats(-4, 4), form=st.sampled_from(FORMS))
def test_compressed_pass_equals_the_filter_run_at_every_sample(seed: int, log_q: float, form: Form) -> None:
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(rng.uniform(0.5e-3, 2e-3, 600))
    a = rng.normal(0.0, 1.0, 600)
    seen_s = np.sort(rng.uniform(t_s[2], t_s[-2], 40))
    seen_s = seen_s[np.diff(np.searchsorted(t_s, seen_s), append=10_000) > 0]  # one a sample
    seen = rng.normal(0.0, 1.0, len(seen_s))
    motion = observed_by_readings(t_s, a, seen_s, seen, None, form)
    np.testing.assert_allclose(
        estimate(motion, 10.0**log_q), by_matrices(t_s, a, seen_s, seen, form, 10.0**log_q), rtol=1e-7, atol=1e-9
    )


@pytest.mark.parametrize("name", ARTIFICIAL)
def test_one_candidate_at_a_time_equals_all_at_once(name: str) -> None:
    motion = observed(ARTIFICIAL[name], 3)
    ratios = 10.0 ** np.linspace(-6, 5, 23)
    together = exact(motion, ratios)
    for i, ratio in enumerate(ratios):
        alone = exact(motion, np.array([ratio]))
        for told in ("mse", "deviance", "r"):
            assert getattr(alone, told)[0] == pytest.approx(getattr(together, told)[i], rel=1e-10)


@pytest.mark.parametrize("name", ARTIFICIAL)
def test_compiled_arrays_and_plain_floats_give_the_same_bits(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    motion = observed(ARTIFICIAL[name], 1)
    ratios = 10.0 ** np.linspace(-6, 6, 2 * FEW)
    monkeypatch.setattr(compiled, "wanted", lambda _: False)
    together, alone = exact(motion, ratios), [exact(motion, ratios[i : i + 1]) for i in range(len(ratios))]
    plain = innovations(motion, 3.0)
    monkeypatch.setattr(compiled, "wanted", lambda _: True)
    fast = exact(motion, ratios)
    for sums in ("squares", "weighted", "log_s"):
        np.testing.assert_array_equal(getattr(fast, sums), getattr(together, sums))
        np.testing.assert_array_equal(getattr(fast, sums), [getattr(one, sums)[0] for one in alone])
    np.testing.assert_array_equal(innovations(motion, 3.0), plain)


@pytest.mark.parametrize("form", FORMS)
def test_deviance_is_that_of_the_readings_joint_normal_distribution(form: Form) -> None:
    n, dt, q, r = 25, 0.2, 0.7, 0.3
    rng = np.random.default_rng(8)
    u, y = rng.normal(size=n + 1), rng.normal(size=n + 1)
    motion = observed_at_every_step(u, y, dt, form=form)
    # What each step's noise adds to each later reading, and what the input alone makes.
    A, B = np.array([[1.0, dt], [0.0, 1.0]]), np.array([dt * dt / 2, dt])
    shape = np.outer(B, B) if form == "BqB" else np.eye(2)
    powers = [np.linalg.matrix_power(A, k)[0] for k in range(n)]
    mean = np.array([sum(powers[k - j] @ B * u[j + 1] for j in range(k + 1)) for k in range(n)])
    covariance = np.array(
        [[sum(powers[i - m] @ shape @ powers[j - m] for m in range(min(i, j) + 1)) for j in range(n)] for i in range(n)]
    )
    e, s = innovations(motion, q / r)
    ours = float((e * e / (s * r) + np.log(s * r)).sum()) + n * np.log(2 * np.pi)
    other = -2 * multivariate_normal(mean, q * covariance + r * np.eye(n)).logpdf(y[1:])
    assert ours == pytest.approx(other, rel=1e-9)
    # Concentrated: the same with the likeliest r.
    told = exact(motion, np.array([q / r]))
    best_r = float(told.r[0])
    at_best = -2 * multivariate_normal(mean, best_r * (q / r * covariance + np.eye(n))).logpdf(y[1:])
    assert told.deviance[0] + n + n * np.log(2 * np.pi) == pytest.approx(at_best, rel=1e-9)


@pytest.mark.parametrize("name", ARTIFICIAL)
@pytest.mark.parametrize("log_ratio", [-5, -2, 0, 2, 5])
def test_settled_gain_solves_the_riccati_equation(name: str, log_ratio: int) -> None:
    motion = observed(ARTIFICIAL[name], 0)
    dt = motion.dt_s[0]
    pp, pv, vv = 10.0**log_ratio * motion.noise[0]
    a = np.array([[1.0, dt], [0.0, 1.0]])
    prior = solve_discrete_are(a.T, H.T, np.array([[pp, pv], [pv, vv]]), np.eye(1))
    s, k0, k1 = (float(value[0]) for value in steady_gain(motion, np.array([10.0**log_ratio])))
    assert s == pytest.approx(prior[0, 0] + 1, rel=1e-8)
    assert k0 == pytest.approx(prior[0, 0] / s, rel=1e-6)
    assert k1 == pytest.approx(prior[0, 1] / s, rel=1e-6)


def test_scan_differs_from_the_filter_by_its_start_only() -> None:
    motion = observed(ARTIFICIAL["AS-5"], 1)  # a short memory: the start is a fraction of it
    ratios = 10.0 ** np.linspace(2, 6, 9)
    np.testing.assert_allclose(scan(motion, ratios).mse, exact(motion, ratios).mse, rtol=0.01)
    np.testing.assert_allclose(scan(motion, ratios).r, exact(motion, ratios).r, rtol=0.01)


def test_mean_error_with_the_true_noises_is_kalatas() -> None:
    """Expected posterior variance of the position in closed form; 300 records of AS-1."""
    case = ARTIFICIAL["AS-1"]
    index = case.dt_s**2 * np.sqrt(case.var_w / case.var_v)
    root = (4 + index - np.sqrt(8 * index + index**2)) / 4
    expected = (1 - root**2) * case.var_v
    assert expected == pytest.approx(0.13185, abs=5e-6)
    means = [float(exact(observed(case, seed), np.ones(1)).mse[0]) for seed in range(300)]
    # The filter starts from the true state, so the first readings are better than the settled ones: half a percent.
    assert np.mean(means) == pytest.approx(expected, abs=4 * np.std(means) / np.sqrt(len(means)) + 0.005 * expected)


def test_artificial_signal_obeys_the_model() -> None:
    case = ARTIFICIAL["AS-1"]
    drawn, noise = signal(case, 5), np.random.default_rng(5)
    w, v = noise.standard_normal(case.n), noise.standard_normal(case.n)
    p = speed = 0.0
    for k in range(1, case.n):
        a = 9.81 * np.sin(k * case.dt_s / 2) + w[k]
        p, speed = p + case.dt_s * speed + case.dt_s**2 / 2 * a, speed + case.dt_s * a
        assert drawn.truth[k] == pytest.approx(p, rel=1e-9)
        assert drawn.y[k] == pytest.approx(p + v[k], rel=1e-9)


def test_bad_data_are_refused_in_one_sentence() -> None:
    n = 20
    u, y = np.zeros(n), np.arange(n, dtype=float)
    bad = np.where(np.arange(n) == 5, np.nan, y)
    for arguments, words in (
        ((u[:4], y[:4], 0.1), "3 readings of the displacement are too few"),
        ((u[:0], y[:0], 0.1), "0 readings of the displacement are too few"),
        ((u, bad, 0.1), "the displacement has 1 values that are no finite number"),
        ((bad, y, 0.1), "the input has"),
        ((u, y, 0.1, bad), "the truth has 1 values"),
        ((u, np.full(n, 3.0), 0.1), "the displacement is constant"),
        ((u, y[:7], 0.1), "y has shape"),
        ((u, y, 0.0), "dt is 0.0"),
        ((u, y, float("nan")), "dt is nan"),
    ):
        with pytest.raises(ValueError, match=words):
            observed_at_every_step(*arguments)


def test_readings_outside_the_record_or_at_one_sample_count_once() -> None:
    t_s = np.linspace(0.0, 0.99, 100)
    seen_s = np.concatenate([[-1.0, 0.0], np.arange(0.1, 0.9, 0.1), [0.8001, 5.0]])
    motion = observed_by_readings(t_s, np.zeros(100), seen_s, np.arange(len(seen_s), dtype=float), None, "BqB")
    assert isinstance(motion, Observed)
    assert len(motion.y) == 9
    assert motion.dt_s.sum() == pytest.approx(0.81)
