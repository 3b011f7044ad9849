from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.orientation import (
    IDENTITY,
    Quaternion,
    corrected,
    gravity_deviation,
    matrix,
    multiply,
    normalised,
    propagated,
    rotated,
    shrunk,
)
from estimation.records import Vector

part = st.floats(-1, 1)
quaternions = st.tuples(part, part, part, part).filter(lambda q: math.hypot(*q) > 0.1).map(lambda q: normalised(q))
vectors = st.tuples(*(st.floats(-20, 20),) * 3)


def scipys(q: Quaternion) -> Rotation:
    w, x, y, z = q
    return Rotation.from_quat([x, y, z, w])


def ours(rotation: Rotation) -> Quaternion:
    x, y, z, w = rotation.as_quat().tolist()
    return (w, x, y, z)


def as_vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)


def tilt(q: Quaternion) -> float:
    """Angle [rad] between the level frame's z and the sensor's up after a true rotation of none."""
    return math.acos(min(1.0, rotated(q, (0.0, 0.0, 1.0))[2]))


@given(quaternions, quaternions)
@settings(derandomize=True, deadline=None)
def test_product_is_the_rotation_by_the_second_and_then_the_first(a: Quaternion, b: Quaternion) -> None:
    product = multiply(a, b)
    assert math.hypot(*product) == pytest.approx(1.0)
    assert (scipys(product) * (scipys(a) * scipys(b)).inv()).magnitude() == pytest.approx(0.0, abs=1e-7)


@given(quaternions, vectors)
@settings(derandomize=True, deadline=None)
def test_matrix_and_rotated_vector_are_scipys(q: Quaternion, v: Vector) -> None:
    np.testing.assert_allclose(matrix(q), scipys(q).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(rotated(q, v), scipys(q).apply(v), atol=1e-11)


@given(quaternions, st.tuples(*(st.floats(-5, 5),) * 3), st.floats(1e-4, 0.2))
@settings(derandomize=True, deadline=None)
def test_constant_rate_turns_the_sensor_about_its_own_axes(q: Quaternion, rate: Vector, dt_s: float) -> None:
    turned = scipys(propagated(q, rate, dt_s))
    expected = scipys(q) * Rotation.from_rotvec(np.array(rate) * dt_s)
    assert (turned * expected.inv()).magnitude() == pytest.approx(0.0, abs=1e-7)


def test_a_rotation_in_many_small_steps_ends_where_the_whole_one_does() -> None:
    rate = (0.3, -0.2, 0.5)
    q = IDENTITY
    for _ in range(2000):
        q = propagated(q, rate, 0.002)
    whole = Rotation.from_rotvec(np.array(rate) * 4.0)
    assert (scipys(q) * whole.inv()).magnitude() < 1e-6  # scipy's angle is no finer than 1e-8


def test_no_rate_and_hardly_any_rate_turn_by_just_that() -> None:
    assert propagated(IDENTITY, (0.0, 0.0, 0.0), 0.01) == IDENTITY
    _, x, _, _ = propagated(IDENTITY, (1e-9, 0.0, 0.0), 0.01)
    assert x == pytest.approx(0.5e-11)


def test_rate_equation_of_the_paper_holds_for_sensor_to_level_quaternions() -> None:
    # Paper C, eq. (4): dq/dt = 1/2 q (x) [0, omega], as a difference quotient of the exact motion.
    q, rate, dt_s = ours(Rotation.from_euler("xyz", [0.3, -0.4, 1.1])), (0.7, -0.3, 0.4), 1e-6
    after = propagated(q, rate, dt_s)
    quotient = [(b - a) / dt_s for a, b in zip(q, after, strict=True)]
    half = [0.5 * c for c in multiply(q, (0.0, *rate))]
    np.testing.assert_allclose(quotient, half, atol=1e-5)


@given(vectors)
@settings(derandomize=True, deadline=None)
def test_gravity_deviation_carries_up_to_the_given_direction_by_the_shortest_way(v: Vector) -> None:
    norm = math.hypot(*v)
    assume(norm > 1e-3)
    up = as_vector(np.array(v) / norm)
    dq = gravity_deviation(up)
    np.testing.assert_allclose(scipys(dq).apply([0.0, 0.0, 1.0]), up, atol=1e-6)
    assert dq[3] == 0.0  # no turn about the vertical


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
def test_gravity_deviation_knows_the_axes_even_upside_down(up: Vector) -> None:
    np.testing.assert_allclose(rotated(gravity_deviation(up), (0.0, 0.0, 1.0)), up, atol=1e-12)


@given(vectors, st.floats(0, 1))
@settings(derandomize=True, deadline=None)
def test_shrinking_keeps_the_axis_and_takes_that_share_of_the_angle(v: Vector, gain: float) -> None:
    rotvec = np.array(v) / 20.0 * 1.7  # up to 2.9 rad
    small = scipys(shrunk(ours(Rotation.from_rotvec(rotvec)), gain)).as_rotvec()
    np.testing.assert_allclose(small, gain * rotvec, atol=1e-7)


def test_correction_shrinks_the_tilt_of_a_resting_sensor_by_its_gain_and_converges() -> None:
    true = Rotation.from_euler("xy", [0.4, -0.3])  # sensor to level
    felt = as_vector(true.inv().apply([0.0, 0.0, 9.81]))
    q = IDENTITY

    def error(q: Quaternion) -> float:
        return math.acos(min(1.0, float((scipys(q).apply(felt) / 9.81)[2])))

    before = error(q)
    for _ in range(20):
        q = corrected(q, felt, 0.1)
        assert error(q) == pytest.approx(0.9 * before, rel=1e-6)
        before = error(q)


@given(quaternions, vectors)
@settings(derandomize=True, deadline=None)
def test_gain_one_levels_at_once_and_leaves_the_heading_reference_alone(q: Quaternion, v: Vector) -> None:
    assume(math.hypot(*v) > 1.0)
    level = corrected(q, v, 1.0)
    assume(rotated(q, v)[2] > -0.999 * math.hypot(*v))
    np.testing.assert_allclose(rotated(level, v), (0.0, 0.0, math.hypot(*v)), atol=1e-6)
    # The correction turned about a horizontal axis of the level frame: nothing about the vertical.
    turn = scipys(level) * scipys(q).inv()
    assert turn.as_quat()[2] == pytest.approx(0.0, abs=1e-7)


def test_the_order_printed_in_the_paper_would_increase_the_tilt() -> None:
    # Paper C, eq. (8) as printed, q (x) dq, holds for the opposite convention only.
    felt = as_vector(Rotation.from_euler("x", 0.2).inv().apply([0.0, 0.0, 1.0]))
    printed = multiply(IDENTITY, gravity_deviation(rotated(IDENTITY, felt)))
    assert rotated(corrected(IDENTITY, felt, 1.0), felt)[2] == pytest.approx(1.0)
    assert rotated(printed, felt)[2] == pytest.approx(math.cos(0.4))


def test_free_fall_corrects_nothing() -> None:
    q = ours(Rotation.from_euler("xyz", [0.1, 0.2, 0.3]))
    assert corrected(q, (0.0, 0.0, 0.0), 1.0) == q
