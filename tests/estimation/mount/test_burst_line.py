from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize, stats

from estimation.mount.burst_line import burst_line, chi_square_tail
from estimation.mount.velocity_steps import VelocityStep
from tests.estimation.support import Floats

SIZES = 1e-3 * np.array([14.5, -14.5, -35.2, 35.2])
SIGMAS = 1e-3 * np.array([0.9, 1.2, 0.8, 1.0])


def steps_along(direction: Floats, rng: np.random.Generator, sizes: Floats = SIZES) -> list[VelocityStep]:
    return [
        VelocityStep(float(k), size * direction + rng.normal(0.0, sigma, 3), float(sigma), 1.0)
        for k, (size, sigma) in enumerate(zip(sizes, np.resize(SIGMAS, len(sizes)), strict=True))
    ]


def any_direction(rng: np.random.Generator) -> Floats:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def test_line_is_the_most_likely_one() -> None:
    """Against a numerical search over direction and sizes together."""
    rng = np.random.default_rng(1)
    steps = steps_along(any_direction(rng), rng)

    def misfit(p: Floats) -> float:
        u = np.array([np.sin(p[0]) * np.cos(p[1]), np.sin(p[0]) * np.sin(p[1]), np.cos(p[0])])
        return sum(
            float(np.sum((s.change - 1e-3 * m * u) ** 2)) / s.sigma**2 for s, m in zip(steps, p[2:], strict=True)
        )

    line = burst_line(steps)
    x, y, z = line.direction
    start = [np.arccos(z) + 0.1, np.arctan2(y, x) - 0.1, *(1e3 * line.sizes + 1.0)]
    best = optimize.minimize(misfit, start, method="BFGS")
    assert line.chi_square == pytest.approx(best.fun, rel=1e-6)
    theta, phi = best.x[:2]
    found = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    assert abs(line.direction @ found) == pytest.approx(1.0, abs=1e-8)


def test_stated_sigma_and_chi_square_are_those_of_many_draws() -> None:
    rng = np.random.default_rng(2)
    n, nees, chi_square = 2000, 0.0, 0.0
    for _ in range(n):
        u = any_direction(rng)
        line = burst_line(steps_along(u, rng))
        nees += float(np.sum(np.cross(line.direction, u) ** 2)) / line.sigma_rad**2
        chi_square += line.chi_square
    assert line.degrees_of_freedom == 6
    # Sums of chi-squares with 2 and 6 degrees of freedom; sigma is widened where the steps scatter more.
    assert chi_square / n == pytest.approx(6.0, abs=3.5 * np.sqrt(12 / n))
    assert 1.5 < nees / n < 2.0 + 3.5 * np.sqrt(4 / n)


@given(st.integers(1, 2000), st.floats(0.0, 1e5))
def test_tail_is_that_of_chi_square(half: int, chi_square: float) -> None:
    expected = stats.chi2.sf(chi_square, 2 * half)
    assert chi_square_tail(chi_square, 2 * half) == pytest.approx(expected, rel=1e-6, abs=1e-200)


def test_one_odd_step_is_left_out_but_not_one_of_three() -> None:
    rng = np.random.default_rng(3)
    u = np.array([0.0, 1.0, 0.0])
    odd = VelocityStep(9.0, np.array([0.03, 0.0, 0.01]), 1e-3, 1.0)
    line = burst_line([*steps_along(u, rng), odd])
    assert odd not in line.steps
    assert len(line.steps) == 4
    assert abs(line.direction @ u) > np.cos(np.radians(5))
    assert not burst_line([*steps_along(u, rng, SIZES[:2]), odd]).agrees


def test_steps_no_larger_than_their_noise_tell_no_line() -> None:
    rng = np.random.default_rng(4)
    line = burst_line(steps_along(any_direction(rng), rng, np.zeros(6)))
    assert line.sigma_rad > np.radians(15)


def test_many_steps_that_scatter_a_little_more_than_stated_still_make_a_line() -> None:
    rng = np.random.default_rng(5)
    u = any_direction(rng)
    sure = [replace(step, sigma=step.sigma / 1.2) for step in steps_along(u, rng, np.tile(SIZES, 100))]
    line = burst_line(sure)
    assert line.agrees
    assert len(line.steps) == 400
    assert float(np.sum(np.cross(line.direction, u) ** 2)) / line.sigma_rad**2 < stats.chi2.ppf(0.999, 2)


def test_many_steps_in_all_directions_make_no_line() -> None:
    rng = np.random.default_rng(6)
    line = burst_line([step for _ in range(300) for step in steps_along(any_direction(rng), rng, SIZES[:1])])
    assert not line.agrees
    assert len(line.steps) == 200
