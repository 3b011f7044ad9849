"""Earth, attitudes, strapdown navigation, coarse and fine alignment: closed forms, scipy, python-ins, statistics."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from daemon.offline.alignment.grades import load_grades
from estimation.alignment.attitude import cross_matrix, from_angles, misalignment, rotation, to_angles
from estimation.alignment.coarse import as_printed, nearest_rotation, triad
from estimation.alignment.earth import RATE_RAD_S, Place
from estimation.alignment.fine import Prior
from estimation.alignment.mechanisation import Strapdown
from estimation.alignment.scenarios import ALIGNMENTS, Aligned, play
from estimation.alignment.verdict import Verdict, limits, rest_faults, verdicts
from tests.estimation.alignment import pushes

GRADES = load_grades()
OTHER = json.loads((Path(__file__).parent / "data" / "python_ins.json").read_text())["states"]
RUNS = 200
angle = st.floats(-1.4, 1.4)
# Posterior sigma of level (east, north) [urad] and heading [deg], by another program.
KNOWN = {
    "AL-1": (50.6, 50.5, 0.996),
    "AL-2": (50.2, 50.2, 0.127),
    "AL-3": (50.1, 50.2, 0.0613),
    "AL-4": (305, 305, 3.63),
    "AL-5": (350, 350, 4.99),
    "AL-6": (348, 348, 5.14),
    "AL-7": (17390, 17390, 24.8),
    "AL-8": (50.6, 50.5, 0.996),
    "AL-9": (50.1, 50.2, 0.111),
}


# --- Earth ------------------------------------------------------------------------------------------------------------


def test_gravity_is_that_of_wgs_84() -> None:
    assert Place(0).gravity_m_s2 == pytest.approx(9.7803253359, abs=1e-10)
    assert Place(45).gravity_m_s2 == pytest.approx(9.8061977695, abs=1e-8)
    assert Place(89.8999).gravity_m_s2 == pytest.approx(9.8321849378, abs=1e-6)
    # Free air: 0.3086 mGal a metre, and the other way down a shaft of the same.
    assert Place(45, 1000).gravity_m_s2 - Place(45).gravity_m_s2 == pytest.approx(-3.084e-3, abs=4e-6)
    assert Place(40, -800).gravity_m_s2 > Place(40).gravity_m_s2


def test_radii_and_rate() -> None:
    meridian, vertical = Place(0).radii_m
    assert vertical == pytest.approx(6378137.0)
    assert meridian == pytest.approx(6335439.327, abs=0.01)
    assert np.linalg.norm(Place(33).rate) == pytest.approx(RATE_RAD_S)
    for bad in ({"latitude_deg": 90.0}, {"latitude_deg": float("nan")}, {"latitude_deg": 10, "height_m": 1e6}):
        with pytest.raises(ValueError, match=r"latitude|height"):
            Place(**bad)


# --- attitudes --------------------------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None, derandomize=True)
@given(pitch=angle, roll=angle, yaw=st.floats(-3.1, 3.1))
def test_angles_are_those_of_scipys_rotation(pitch: float, roll: float, yaw: float) -> None:
    ours = from_angles(*(np.array(one) for one in (pitch, roll, yaw)))
    np.testing.assert_allclose(ours, Rotation.from_euler("ZXY", [yaw, pitch, roll]).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(to_angles(ours), (pitch, roll, yaw), atol=1e-7)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(v=st.tuples(*[st.floats(-2, 2)] * 3), size=st.sampled_from([1.0, 1e-3, 1e-5, 1e-9]))
def test_rotation_vectors_are_scipys(v: tuple[float, float, float], size: float) -> None:
    vector = size * np.array(v)
    np.testing.assert_allclose(rotation(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(cross_matrix(vector) @ np.array([1.0, 2.0, 3.0]), np.cross(vector, [1.0, 2.0, 3.0]))


def test_misalignment_undoes_itself() -> None:
    rng = np.random.default_rng(3)
    true = rotation(rng.normal(size=(20, 3)))
    phi = 1e-4 * rng.normal(size=(20, 3))
    np.testing.assert_allclose(misalignment(rotation(-phi) @ true, true), phi, atol=1e-12)


# --- strapdown navigation ---------------------------------------------------------------------------------------------


def test_a_resting_sensor_stays_where_it_is() -> None:
    place = Place(52.0, 120.0)
    true = from_angles(np.array(0.1), np.array(-0.2), np.array(2.0))
    turn, force = true.T @ place.rate, true.T @ np.array([0, 0, place.gravity_m_s2])
    strapdown = Strapdown(place, true, np.zeros(3))
    for _ in range(6000):
        strapdown.step(turn * 0.1, force * 0.1, 0.1)
    assert np.abs(strapdown.velocity).max() < 1e-6
    assert np.abs(misalignment(strapdown.attitude, true)).max() < 1e-9
    assert strapdown.place.latitude_deg == pytest.approx(52.0, abs=1e-9)


def test_an_accelerometer_bias_swings_with_schulers_period() -> None:
    """Position error of a constant bias b: (b/g) R (1 - cos t sqrt(g/R)), back at zero after 84.4 minutes."""
    place = Place(0.001)
    bias = 1e-4
    strapdown = Strapdown(place, np.eye(3), np.zeros(3), holds_height=True)
    turn = place.rate
    ways = []
    for step in range(5064):
        strapdown.step(turn * 1.0, np.array([0.0, bias, place.gravity_m_s2]), 1.0)
        if step in (2531, 5063):
            ways.append(np.radians(strapdown.place.latitude_deg - 0.001) * place.radii_m[0])
    half, whole = ways
    assert half == pytest.approx(2 * bias / place.gravity_m_s2 * place.radii_m[0], rel=0.01)
    assert abs(whole) < 0.02 * half


def test_coning_is_followed() -> None:
    """A cone of 1 degree at 5 Hz, sampled at 100 Hz: uncorrected the attitude would drift 0.014 deg."""
    half_angle, w, dt = np.radians(1.0), 2 * np.pi * 5, 0.01
    times = np.arange(6001) * dt

    def attitude(t: float) -> Rotation:
        return Rotation.from_rotvec(half_angle * np.array([np.cos(w * t), np.sin(w * t), 0.0]))

    place = Place(1e-3)
    earth = place.rate
    strapdown = Strapdown(place, attitude(0.0).as_matrix(), np.zeros(3), moves_place=False)
    for begin, end in pairwise(times):
        fine = np.linspace(begin, end, 21)
        middle = 0.5 * (fine[1:] + fine[:-1])
        turns = [
            (attitude(a).inv() * attitude(b)).as_rotvec() + attitude(m).inv().apply(earth) * (b - a)
            for a, b, m in zip(fine[:-1], fine[1:], middle, strict=True)
        ]
        strapdown.step(np.sum(turns, axis=0), np.zeros(3), dt)
        if end > 6.0:
            break
    drift = misalignment(strapdown.attitude, attitude(6.01).as_matrix())
    assert np.degrees(np.abs(drift).max()) < 1e-3


def test_pushes_navigate_as_python_ins_does() -> None:
    turn, push = pushes.increments()
    start = from_angles(*(np.radians(one) for one in (pushes.PITCH_DEG, pushes.ROLL_DEG, pushes.YAW_DEG)))
    strapdown = Strapdown(
        Place(pushes.LATITUDE_DEG, pushes.HEIGHT_M), start, np.zeros(3), longitude_deg=pushes.LONGITUDE_DEG
    )
    states = {round(one["t_s"] * pushes.RATE_HZ): one for one in OTHER}
    for step, (a, b) in enumerate(zip(turn, push, strict=True), 1):
        strapdown.step(a, b, 1 / pushes.RATE_HZ)
        if step in states:
            other = states[step]
            assert np.abs(misalignment(strapdown.attitude, np.array(other["attitude"]))).max() < 1e-7
            np.testing.assert_allclose(strapdown.velocity, other["velocity"], atol=1e-3)
            north = np.radians(strapdown.place.latitude_deg - other["latitude_deg"]) * 6.36e6
            east = np.radians(strapdown.longitude_deg - other["longitude_deg"]) * 6.38e6 * 0.766
            assert abs(north) < 0.01
            assert abs(east) < 0.01
            assert strapdown.place.height_m == pytest.approx(other["height_m"], abs=0.01)
    assert step == len(turn)


# --- coarse -----------------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None, derandomize=True)
@given(pitch=angle, roll=angle, yaw=st.floats(-3.1, 3.1), latitude=st.floats(-80, 80))
def test_coarse_alignment_of_clean_vectors_is_exact(pitch: float, roll: float, yaw: float, latitude: float) -> None:
    place = Place(latitude)
    true = from_angles(*(np.array(one) for one in (pitch, roll, yaw)))
    force, rate = true.T @ np.array([0, 0, place.gravity_m_s2]), true.T @ place.rate
    assert np.degrees(np.abs(misalignment(triad(force, rate), true)).max()) <= 1e-6
    np.testing.assert_allclose(as_printed(force, rate, place), true, atol=1e-8)


def test_the_nearest_rotation_spoils_the_level_and_the_triad_does_not() -> None:
    place, grade = Place(39.84), GRADES["adis16448_in_run"]
    rng = np.random.default_rng(5)
    pitch, roll = rng.uniform(-0.1, 0.1, (2, RUNS))
    true = from_angles(pitch, roll, rng.uniform(-3, 3, RUNS))
    back = np.swapaxes(true, -1, -2)
    force = back @ np.array([0, 0, place.gravity_m_s2]) + grade.accel_bias * rng.normal(size=(RUNS, 3))
    rate = back @ place.rate + grade.gyro_bias * rng.normal(size=(RUNS, 3))
    # Only gravity's row is asked: where the computed up points.
    up = {
        "triad": triad(force, rate)[:, 2],
        "nearest": nearest_rotation(as_printed(force, rate, place))[:, 2],
    }
    tilt = {
        name: np.degrees(np.arccos(np.clip(np.einsum("ri,ri->r", rows, true[:, 2]), -1, 1)))
        for name, rows in up.items()
    }
    assert np.median(tilt["triad"]) < 1.5 * np.degrees(limits(grade, place).level)
    assert np.median(tilt["nearest"]) > 5.0


# --- fine -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def aligned() -> dict[str, Aligned]:
    return {name: play(case, GRADES[case.grade], RUNS, 1) for name, case in ALIGNMENTS.items()}


@pytest.mark.parametrize("name", ALIGNMENTS)
def test_errors_are_what_is_stated_and_what_is_possible(name: str, aligned: dict[str, Aligned]) -> None:
    one = aligned[name]
    east, north, heading_deg = KNOWN[name]
    stated = (one.sigma[0] * 1e6, one.sigma[1] * 1e6, np.degrees(one.sigma[2]))
    assert stated == pytest.approx((east, north, heading_deg), rel=0.02)
    rms = np.sqrt((one.errors**2).mean(axis=0)) / one.sigma
    nees = one.nees.mean() / 3
    if name == "AL-7":  # a turn-on bias of 0.5 deg/s is beyond first order: it must not run away
        assert nees <= 1.3
    else:
        assert rms.max() <= 1.2  # 0.05 is one sigma of 200 runs
        assert 0.8 <= nees <= 1.2
        assert one.nis == pytest.approx(1.0, abs=0.02)


def test_headings_that_cannot_be_observed_are_not_claimed(aligned: dict[str, Aligned]) -> None:
    told = {}
    for name, case in ALIGNMENTS.items():
        prior = Prior(np.radians(case.level_deg), np.radians(case.heading_deg))
        told[name] = verdicts(aligned[name].sigma, prior, GRADES[case.grade], Place(case.latitude_deg))
    heading = {name: one[2] for name, one in told.items()}
    assert {name for name, one in heading.items() if one is Verdict.OBSERVED} == {"AL-2", "AL-3", "AL-9"}
    assert {name for name, one in heading.items() if one is Verdict.REFUSED} == {"AL-5", "AL-6", "AL-7"}
    assert {name for name, one in heading.items() if one is Verdict.NOT_OBSERVED} == {"AL-1", "AL-4", "AL-8"}
    assert all(one[0] is one[1] is Verdict.OBSERVED for name, one in told.items() if name != "AL-7")


def test_more_than_the_bound_is_never_claimed(aligned: dict[str, Aligned]) -> None:
    """Biases bound what rest can tell, however long it lasts."""
    for name, case in ALIGNMENTS.items():
        bound = limits(GRADES[case.grade], Place(case.latitude_deg))
        prior_bound = np.radians(case.level_deg)
        level = 1 / np.hypot(1 / bound.level, 1 / prior_bound)
        assert aligned[name].sigma[:2].min() >= 0.9 * level


def test_a_sensor_that_moves_or_is_worse_than_its_grade_is_noticed() -> None:
    place, grade = Place(40), GRADES["tactical"]
    force, rate = np.array([0, 0, place.gravity_m_s2]), place.rate
    assert rest_faults(force, rate, 50, grade, place).sentences == []
    (sentence,) = rest_faults(force * 1.01, rate, 50, grade, place).sentences
    assert "off gravity" in sentence
    (sentence,) = rest_faults(force, rate + np.array([0, 0, 1e-3]), 50, grade, place).sentences
    assert "turn-on bias" in sentence
