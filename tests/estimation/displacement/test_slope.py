from __future__ import annotations

import numpy as np
import pytest

from estimation.displacement.slope import Slope


def fed(t_s: list[float], values: list[float]) -> Slope:
    slope = Slope()
    for t, value in zip(t_s, values, strict=True):
        slope.add(round(t * 1e9), value)
    return slope


def test_it_is_the_least_squares_line_through_the_last_two_seconds() -> None:
    rng = np.random.default_rng(1)
    t_s = np.sort(rng.uniform(0.0, 6.0, 90))
    values = 0.0145 * t_s + rng.normal(0.0, 0.003, 90)
    slope = fed(t_s.tolist(), values.tolist())
    recent = t_s >= t_s[-1] - 2.0
    line, covariance = np.polyfit(t_s[recent], values[recent], 1, cov="unscaled")
    fit = slope.fit(0.003)
    assert fit is not None
    assert fit[0] == pytest.approx(line[0], rel=1e-6)
    assert fit[1] == pytest.approx(0.003 * np.sqrt(covariance[0, 0]), rel=1e-6)
    assert slope.mean() == pytest.approx(values[recent].mean())


@pytest.mark.parametrize(
    "t_s",
    [
        [],
        [0.0],
        np.linspace(0.0, 1.5, 30).tolist(),  # spans less than most of the window
        np.linspace(0.0, 2.0, 9).tolist(),  # too few
        [0.0, *np.linspace(5.0, 6.0, 20).tolist()],  # the far one has left the window
    ],
)
def test_too_little_gives_no_opinion(t_s: list[float]) -> None:
    assert fed(t_s, [0.1] * len(t_s)).fit(0.003) is None


def test_cleared_slope_begins_anew() -> None:
    slope = fed(np.linspace(0.0, 2.0, 40).tolist(), [0.0] * 40)
    assert slope.fit(0.001) is not None
    slope.clear()
    assert slope.fit(0.001) is None


@pytest.mark.parametrize(
    ("speed_m_s", "moves", "stands"),
    [(0.0145, True, False), (-0.0352, True, False), (0.007, True, False), (0.001, False, True), (0.0, False, True)],
)
def test_a_ram_moves_or_stands_by_its_slope(speed_m_s: float, moves: bool, stands: bool) -> None:
    rng = np.random.default_rng(3)
    t_s = np.arange(0.0, 2.05, 0.07)
    slope = fed(t_s.tolist(), (speed_m_s * t_s + rng.normal(0.0, 0.002, t_s.size)).tolist())
    speed = slope.moves(0.002, 0.01453)
    assert (speed is not None) is moves
    if speed is not None:
        assert speed == pytest.approx(speed_m_s, abs=0.003)
    assert slope.stands(0.002, 0.01453) is stands


def test_noise_alone_neither_moves_nor_lets_a_stand_be_claimed() -> None:
    t_s = np.arange(0.0, 2.05, 0.07)
    slope = fed(t_s.tolist(), (0.007 * t_s).tolist())
    assert slope.moves(0.03, 0.01453) is None
    assert not slope.stands(0.03, 0.01453)
    empty = Slope()
    assert empty.moves(0.002, 0.01453) is None
    assert not empty.stands(0.002, 0.01453)
    assert empty.since_ns == 0
    assert slope.since_ns == round(t_s[t_s >= t_s[-1] - 2.0][0] * 1e9)
