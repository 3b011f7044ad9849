from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimation.gaussian import Gaussian

Floats = NDArray[np.float64]
N = 4
seeds = st.integers(0, 2**32 - 1)
factors = st.floats(-3, 3)
indices = st.integers(0, N - 1)
pairs = st.permutations(range(N)).map(lambda order: (order[0], order[1]))


def drawn(seed: int) -> tuple[Gaussian, Floats, Floats]:
    """A random state as Gaussian and as dense mean and covariance."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(N, N))
    x, p = rng.normal(size=N), root @ root.T + 0.01 * np.eye(N)
    return Gaussian(x.tolist(), p.tolist()), x, p


def assert_is(g: Gaussian, x: Floats, p: Floats) -> None:
    np.testing.assert_allclose(g.x, x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(g.p, p, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(g.p, np.transpose(g.p), rtol=1e-12, atol=1e-12)


@given(seeds, pairs, factors)
@settings(derandomize=True, deadline=None)
def test_add_is_a_shear_of_mean_and_covariance(seed: int, pair: tuple[int, int], factor: float) -> None:
    g, x, p = drawn(seed)
    shear = np.eye(N)
    shear[pair] = factor
    g.add(*pair, factor)
    assert_is(g, shear @ x, shear @ p @ shear.T)


@given(seeds, indices, factors)
@settings(derandomize=True, deadline=None)
def test_scale_is_a_diagonal_matrix(seed: int, i: int, factor: float) -> None:
    g, x, p = drawn(seed)
    scale = np.eye(N)
    scale[i, i] = factor
    g.scale(i, factor)
    assert_is(g, scale @ x, scale @ p @ scale)


@given(seeds, indices)
@settings(derandomize=True, deadline=None)
def test_diffuse_adds_process_noise_to_one_state_alone(seed: int, i: int) -> None:
    g, x, p = drawn(seed)
    g.diffuse(i, 0.7)
    assert_is(g, x, p + np.diag(0.7 * (np.arange(N) == i)))


@given(seeds, indices)
@settings(derandomize=True, deadline=None)
def test_reset_makes_a_state_independent_and_leaves_the_others(seed: int, i: int) -> None:
    g, x, p = drawn(seed)
    g.reset(i, -2.0, 0.3)
    forget = np.eye(N)
    forget[i, i] = 0.0
    x = forget @ x
    x[i] = -2.0
    p = forget @ p @ forget
    p[i, i] = 0.3
    assert_is(g, x, p)


@given(seeds, pairs)
@settings(derandomize=True, deadline=None)
def test_replace_copies_a_state_with_all_its_correlations(seed: int, pair: tuple[int, int]) -> None:
    g, x, p = drawn(seed)
    i, j = pair
    copy = np.eye(N)
    copy[i] = np.eye(N)[j]
    expected = copy @ p @ copy.T
    expected[i, i] += 0.2
    g.replace(i, j, 0.2)
    assert_is(g, copy @ x, expected)


@given(seeds, st.floats(1e-3, 10))
@settings(derandomize=True, deadline=None)
def test_measurement_agrees_with_the_information_form_and_with_joseph(seed: int, variance: float) -> None:
    g, x, p = drawn(seed)
    h = np.random.default_rng(seed + 1).normal(size=N)
    h[2] = 0.0
    innovation = 1.3
    row = tuple((i, float(h[i])) for i in range(N) if h[i])
    assert g.predicted_variance(row) == pytest.approx(h @ p @ h)
    s = g.measure(row, innovation, variance)

    assert s == pytest.approx(h @ p @ h + variance)
    information = np.linalg.inv(p) + np.outer(h, h) / variance
    posterior = np.linalg.inv(information)
    np.testing.assert_allclose(g.p, posterior, rtol=1e-6, atol=1e-8)
    z = h @ x + innovation
    mean = posterior @ (np.linalg.solve(p, x) + h * z / variance)
    np.testing.assert_allclose(g.x, mean, rtol=1e-6, atol=1e-7)
    gain = p @ h / s
    rest = np.eye(N) - np.outer(gain, h)
    assert_is(g, x + gain * innovation, rest @ p @ rest.T + variance * np.outer(gain, gain))


def test_exact_measurement_of_an_exact_state_teaches_nothing() -> None:
    g = Gaussian.diagonal([1.0, 2.0], [0.0, 3.0])
    assert g.measure(((0, 1.0),), 5.0, 0.0) == 0.0
    assert g.x == [1.0, 2.0]
    assert g.p == [[0.0, 0.0], [0.0, 9.0]]


def test_covariance_stays_symmetric_and_positive_through_ten_thousand_operations() -> None:
    g, _, _ = drawn(3)
    rng = np.random.default_rng(4)
    for _ in range(10_000):
        i, j = rng.permutation(N)[:2].tolist()
        g.add(i, j, 0.01)
        g.scale(j, 0.99)
        g.diffuse(i, 1e-3)
        g.measure(((i, 1.0), (j, -0.5)), rng.normal(), 0.1)
    p = np.array(g.p)
    np.testing.assert_allclose(p, p.T, rtol=1e-9, atol=1e-12)
    assert np.linalg.eigvalsh(p).min() > 0


def test_copy_is_independent() -> None:
    g, x, p = drawn(5)
    other = g.copy()
    other.add(0, 1, 1.0)
    other.reset(2, 0.0, 1.0)
    assert_is(g, x, p)


def test_sigma_is_the_root_of_the_variance_and_never_fails() -> None:
    g = Gaussian.diagonal([0.0, 0.0], [0.25, 1.0])
    assert g.sigma(0) == 0.25
    g.p[1][1] = -1e-30  # what rounding can leave
    assert g.sigma(1) == 0.0
