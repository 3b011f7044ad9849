from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.gaussian import Gaussian
from estimation.mskf import (
    BOW,
    LATENCY,
    LEARNED,
    OFFSET,
    PUSH_FLOW,
    RETRACT_FLOW,
    SCALE,
    SPEED,
    STATES,
    B,
    Filter,
    P,
    V,
)
from estimation.noise import ACCEL_NOISE, GYRO_WALK
from estimation.settings import EstimatorSettings, SupportSettings

Floats = NDArray[np.float64]
N = STATES
DT = 0.01
STROKE = 0.5
OUTLASTING = (SPEED, *LEARNED)


def begun() -> Filter:
    """A filter at rest at 100 mm, nothing learned."""
    return Filter.start(0.1, 0.0005, SupportSettings(stroke_mm=500), EstimatorSettings())


def drawn(seed: int = 1) -> tuple[Filter, Floats, Floats]:
    """A filter in mid-push with everything correlated, and its dense mean and covariance."""
    rng = np.random.default_rng(seed)
    size = np.array([0.01, 0.002, 0.0005, 0.003, 0.01, 0.001, 0.001, 0.005, 0.0003, 0.0007])
    root = rng.normal(size=(N, N)) * size[:, None]
    x = np.array([0.21, 0.0142, 0.0146, 0.004, -0.01, 0.002, 0.001, 0.003, 0.0147, 0.0355])
    p = root @ root.T
    return Filter(Gaussian(x.tolist(), p.tolist()), STROKE), x, p


def unit(i: int, j: int | None = None) -> Floats:
    if j is None:
        return np.asarray(np.eye(N)[i])
    return np.outer(np.eye(N)[i], np.eye(N)[j])


def measured(x: Floats, p: Floats, h: Floats, z: float, r: float) -> tuple[Floats, Floats]:
    """Textbook update in information form."""
    information = np.linalg.inv(p) + np.outer(h, h) / r
    p_new = np.linalg.inv(information)
    return np.asarray(x + p_new @ h * (z - h @ x) / r), np.asarray(p_new, dtype=np.float64)


def considered(x: Floats, p: Floats, h: Floats, z: float, r: float) -> tuple[Floats, Floats]:
    """Update in Joseph's form with a gain that leaves what outlasts the move as it is."""
    gain = p @ h / (h @ p @ h + r)
    gain[list(OUTLASTING)] = 0.0
    keep = np.eye(N) - np.outer(gain, h)
    return np.asarray(x + gain * (z - h @ x)), np.asarray(keep @ p @ keep.T + r * np.outer(gain, gain))


def assert_is(filter_: Filter, x: Floats, p: Floats, rtol: float = 1e-9) -> None:
    scale = np.sqrt(np.diag(p)) + 1e-30
    np.testing.assert_allclose(np.array(filter_.state.x) / scale, x / scale, rtol=rtol, atol=rtol)
    correlation = np.outer(scale, scale)
    np.testing.assert_allclose(np.array(filter_.state.p) / correlation, p / correlation, rtol=0, atol=rtol)


def integration(a: float) -> tuple[Floats, Floats]:
    """Transition F and input u of p' = v, v' = a - b over one step."""
    f = np.eye(N) + DT * unit(P, V) - 0.5 * DT**2 * unit(P, B) - DT * unit(V, B)
    return f, a * (0.5 * DT**2 * unit(P) + DT * unit(V))


def test_rest_keeps_the_displacement_and_stills_the_velocity() -> None:
    filter_, x, p = drawn()
    filter_.rest(DT, 1e-6)
    keep = np.eye(N) - unit(V, V) - unit(B, B)
    expected = keep @ p @ keep + 1e-6 * unit(B, B) + (1e-5) ** 2 * DT * unit(P, P)
    state = filter_.state
    np.testing.assert_allclose(state.x, keep @ x, rtol=1e-12)
    np.testing.assert_allclose(state.p, expected, rtol=1e-12, atol=1e-18)
    before = state.x[P], state.sigma(P)
    for _ in range(10_000):
        filter_.rest(DT, 1e-6)
    assert state.x[P] == before[0]
    assert state.sigma(P) == pytest.approx(math.hypot(before[1], 1e-5 * 10))


def test_burst_integrates_the_levelled_acceleration() -> None:
    filter_, x, p = drawn()
    filter_.burst(DT, 0.13)
    f, u = integration(0.13)
    noise = ACCEL_NOISE**2 * DT * unit(V, V) + GYRO_WALK**2 * DT * unit(B, B)
    assert_is(filter_, f @ x + u, f @ p @ f.T + noise)


def test_a_burst_begins_with_the_velocity_of_the_vibration_in_doubt() -> None:
    filter_, x, p = drawn()
    filter_.begin_burst(0.3)
    assert_is(filter_, x, p + (0.0092 * 0.3) ** 2 * np.outer(unit(V), unit(V)))


def test_cruise_lets_the_velocity_wander_about_its_mean_and_measures_only_the_acceleration_error() -> None:
    filter_, x, p = drawn()
    filter_.state.reset(B, x[B], 4e-6)  # as on entering the cruise
    alone = np.eye(N) - unit(B, B)
    p = alone @ p @ alone + 4e-6 * unit(B, B)
    filter_.cruise(DT, 0.02, 0.1)
    keep = math.exp(-DT / 2.5)
    f = (np.eye(N) + (keep - 1) * unit(V, V) + (1 - keep) * unit(V, SPEED)) @ (np.eye(N) + DT * unit(P, V))
    wander = (0.01 * x[SPEED]) ** 2 * (1 - keep**2)
    noise = wander * unit(V, V) + GYRO_WALK**2 * DT * unit(B, B)
    r = ACCEL_NOISE**2 / DT + (0.3 * 0.1) ** 2
    assert_is(filter_, *measured(f @ x, f @ p @ f.T + noise, unit(B), 0.02, r), rtol=1e-6)


def test_cruise_forgets_its_entry_speed_with_the_time_constant_of_the_wander() -> None:
    filter_ = begun()
    filter_.begin_move(1, 0.015)
    filter_.state.reset(V, 0.016, 1e-8)
    usual = filter_.state.x[PUSH_FLOW]
    for _ in range(250):
        filter_.cruise(DT, 0.0, 0.0)
    assert filter_.state.x[V] == pytest.approx(usual + (0.016 - usual) * math.exp(-1), rel=1e-6)


@pytest.mark.parametrize(("direction", "flow"), [(1, PUSH_FLOW), (-1, RETRACT_FLOW)])
def test_begin_move_scatters_about_the_usual_speed_and_forgets_the_last_one(direction: int, flow: int) -> None:
    filter_, x, p = drawn()
    filter_.begin_move(direction, 0.015)
    f = np.eye(N) - unit(SPEED, SPEED) + direction * unit(SPEED, flow)
    assert_is(filter_, f @ x, f @ p @ f.T + (0.015 * x[flow]) ** 2 * unit(SPEED, SPEED))


def test_a_move_noticed_late_has_gone_on_at_its_speed() -> None:
    filter_, x, p = drawn()
    filter_.catch_up(7.0)
    f = np.eye(N) + 7.0 * unit(P, SPEED)
    assert_is(filter_, f @ x, f @ p @ f.T)


def test_a_move_of_unknown_length_ended_anywhere_up_to_its_stop() -> None:
    filter_ = begun()
    filter_.lose_way(1)
    assert filter_.state.x[P] == pytest.approx(0.3)
    assert filter_.state.sigma(P) == pytest.approx(0.4 / math.sqrt(12), rel=1e-3)


def test_a_burst_measures_the_speed_of_the_move() -> None:
    filter_, x, p = drawn()
    filter_.hear_burst(0.0151, 0.0006)
    assert_is(filter_, *measured(x, p, unit(SPEED), 0.0151, 0.0006**2), rtol=1e-6)


def test_one_pump_feeds_both_directions() -> None:
    filter_ = begun()
    g = filter_.state
    retract_before = g.sigma(RETRACT_FLOW)
    g.measure(((PUSH_FLOW, 1.0),), 0.02 * g.x[PUSH_FLOW], 1e-12)  # a push 2 % faster than nominal
    assert g.x[RETRACT_FLOW] == pytest.approx(0.03519 * 1.018, rel=1e-4)
    assert g.sigma(RETRACT_FLOW) == pytest.approx(retract_before * math.sqrt(1 - 0.9**2), rel=1e-3)


def test_speed_reached_says_that_velocity_equals_speed() -> None:
    filter_, x, p = drawn()
    filter_.speed_reached(0.2)
    r = (0.0092 * 0.2) ** 2 + (0.01 * x[SPEED]) ** 2
    assert_is(filter_, *considered(x, p, unit(V) - unit(SPEED), 0.0, r), rtol=1e-6)


def test_entering_cruise_puts_speed_and_ripple_in_place_of_the_vibrating_velocity() -> None:
    filter_, x, p = drawn()
    filter_.enter_cruise()
    f = np.eye(N) - unit(V, V) + unit(V, SPEED)
    alone = np.eye(N) - unit(B, B)  # the acceleration error is a filter of its own from here on
    p = f @ p @ f.T + (0.01 * x[SPEED]) ** 2 * unit(V, V)
    assert_is(filter_, f @ x, alone @ p @ alone + p[B, B] * unit(B, B))


def test_zero_velocity_at_the_end_corrects_the_path_and_no_more() -> None:
    filter_, x, p = drawn()
    before = [filter_.state.sigma(i) for i in range(N)]
    filter_.stopped(0.05)
    r = 0.0007**2 + (0.0092 * 0.05) ** 2
    assert_is(filter_, *considered(x, p, unit(V), 0.0, r), rtol=1e-6)
    after = [filter_.state.sigma(i) for i in range(N)]
    assert all(b <= a for a, b in zip(before, after, strict=True))
    assert after[P] < before[P]


def test_a_known_burst_and_cruise_are_followed_to_the_end() -> None:
    # Noise-free: trapezoid of 14.5 mm/s with ramps of 0.5 s, 4 s long; the filter expects 14.3.
    filter_ = begun()
    filter_.state.reset(PUSH_FLOW, 0.0143, 0.0003**2)
    filter_.begin_move(1, 0.001)
    for _ in range(50):
        filter_.burst(DT, 0.029)
    filter_.speed_reached(0.0)
    filter_.hear_burst(0.0145, 0.00005)
    filter_.enter_cruise()
    for _ in range(300):
        filter_.cruise(DT, 0.0, 0.0)
    sigma_before = filter_.state.sigma(P)
    for _ in range(50):
        filter_.burst(DT, -0.029)
    filter_.stopped(0.0)
    true_m = 0.1 + 0.0145 * 3.5
    assert abs(filter_.state.x[P] - true_m) < 3 * filter_.state.sigma(P)
    assert filter_.state.x[P] == pytest.approx(true_m, abs=0.001)
    assert filter_.state.sigma(P) < sigma_before + 0.0005


def test_free_motion_integrates_with_great_doubt() -> None:
    filter_, x, p = drawn()
    filter_.begin_free()
    filter_.free(DT, 1.5, 2.0)
    f, u = integration(1.5)
    # Shaking of 2 m/s^2 that differs from block to block puts 2 m/s^2 * dt on the velocity of each.
    p = f @ (p + 0.3**2 * unit(B, B)) @ f.T + (0.05**2 * DT + (2.0 * DT) ** 2) * unit(V, V)
    forget = np.eye(N) + (math.exp(-DT / 2.0) - 1) * unit(V, V)
    assert_is(filter_, forget @ (f @ x + u), forget @ p @ forget)


def test_blind_motion_is_a_random_walk_of_the_velocity() -> None:
    filter_, x, p = drawn()
    filter_.blind(DT)
    f = np.eye(N) + DT * unit(P, V)
    q = 0.06**2
    forget = np.eye(N) + (math.exp(-DT / 2.0) - 1) * unit(V, V)
    p = forget @ (f @ p @ f.T + q * DT**3 / 3 * unit(P, P) + q * DT * unit(V, V)) @ forget
    assert_is(filter_, forget @ f @ x, p)


@pytest.mark.parametrize("kind", ["free", "blind"])
def test_long_ignorance_is_admitted_and_stays_bounded(kind: str) -> None:
    filter_ = begun()
    filter_.begin_free()
    sigmas = []
    for _ in range(2000):
        if kind == "free":
            filter_.free(0.1, 0.5, 0.0)
        else:
            filter_.blind(0.1)
        sigmas.append(filter_.state.sigma(P))
    assert sigmas[-1] >= STROKE / 2
    assert max(sigmas) <= STROKE
    assert 0.0 <= filter_.state.x[P] <= STROKE


def test_a_very_long_silence_is_no_worse_than_a_long_one() -> None:
    filter_ = begun()
    filter_.blind(1e6)
    assert filter_.state.x[P] == STROKE / 2
    assert filter_.state.sigma(P) == STROKE


@pytest.mark.parametrize("lag_s", [0.0, 0.0175, 0.3])
def test_sensitivity_of_the_displacement_prediction_is_its_derivative(lag_s: float) -> None:
    filter_, x, _ = drawn()
    predicted, row = filter_.displacement_prediction(lag_s)
    p = x[P] - (lag_s + x[LATENCY]) * x[V]
    bowed = 4 * x[BOW] * p * (STROKE - p) / STROKE**2
    assert predicted == pytest.approx((1 + x[SCALE]) * p + x[OFFSET] + bowed)
    h = np.zeros(N)
    for i, a in row:
        h[i] = a
    for i in range(N):
        up, down = drawn()[0], drawn()[0]
        up.state.x[i] += 1e-6
        down.state.x[i] -= 1e-6
        slope = up.displacement_prediction(lag_s)[0] - down.displacement_prediction(lag_s)[0]
        assert h[i] == pytest.approx(slope / 2e-6, abs=1e-8)


def test_mechanical_stop_is_a_measurement_of_the_displacement() -> None:
    filter_, x, p = drawn()
    filter_.at_stop(0.5, 0.0006)
    assert_is(filter_, *measured(x, p, unit(P), 0.5, 0.0006**2), rtol=1e-6)


def test_copy_moves_on_its_own() -> None:
    filter_, x, p = drawn()
    other = filter_.copy()
    other.cruise(DT, 0.1, 0.1)
    assert_is(filter_, x, p)


def test_unwatched_cruise_is_the_watched_one_without_the_measurement() -> None:
    filter_, x, p = drawn()
    filter_.cruise_unwatched(0.2)
    keep = math.exp(-0.2 / 2.5)
    f = (np.eye(N) + (keep - 1) * unit(V, V) + (1 - keep) * unit(V, SPEED)) @ (np.eye(N) + 0.2 * unit(P, V))
    assert_is(filter_, f @ x, f @ p @ f.T + (0.01 * x[SPEED]) ** 2 * (1 - keep**2) * unit(V, V))


def test_unwatched_rest_keeps_the_displacement_but_doubts_it() -> None:
    filter_, x, p = drawn()
    filter_.rest_unwatched(0.2)
    assert_is(filter_, x, p + (0.005 * 0.2) ** 2 * unit(P, P))
