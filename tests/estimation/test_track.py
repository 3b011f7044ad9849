from __future__ import annotations

import math

import numpy as np
import pytest

from estimation.belief import Belief, Phase
from estimation.displacement.sensor import Reading
from estimation.mskf import PUSH_FLOW, SPEED, Filter, P
from estimation.recognition.motion import Motion
from estimation.records import Vector
from estimation.settings import EstimatorSettings, SupportSettings
from estimation.track import Step, Track

S = 10**9
GRAVITY: Vector = (0.0, 0.0, 9.80665)


def track(p_m: float = 0.0, **settings: float) -> tuple[Track, EstimatorSettings]:
    estimator = EstimatorSettings.model_validate(settings)
    return Track.begin(Filter.start(p_m, 0.0005, SupportSettings(), estimator)), estimator


def play(
    of: Track, belief: Belief, settings: EstimatorSettings, from_s: float, to_s: float, value_m: float | None = None
) -> None:
    """Steps of 10 ms with gravity alone, and a reading every fifth if given."""
    for i in range(round(from_s * 100) + 1, round(to_s * 100) + 1):
        readings = [] if value_m is None or i % 5 else [Reading(i * S // 100, value_m, variance_m2=1e-5)]
        of.advance(Step(i * S // 100, 0.01, GRAVITY, (0.0,) * 3, GRAVITY, readings=readings), belief, settings, 0.0)


def test_a_tilted_sensor_at_rest_feels_no_acceleration() -> None:
    of, settings = track()
    tilted = (0.0, 9.81 * math.sin(0.05), 9.81 * math.cos(0.05))
    for i in range(1, 500):
        of.advance(Step(i * 10**7, 0.01, tilted, (0.01, 0.02, 0.03), tilted), Belief(), settings, 0.0)
    assert of.acceleration_m_s2 == pytest.approx(0.0, abs=1e-9)
    assert of.gravity_m_s2 == pytest.approx(9.81)
    assert of.gyro_bias == pytest.approx((0.01, 0.02, 0.03))
    assert of.filter.state.x[P] == 0.0


def test_the_gyro_levels_the_acceleration_while_moving() -> None:
    of, settings = track()
    play(of, Belief(), settings, 0.0, 5.0)
    belief = Belief([Motion(1, 5 * S, confirmed=True)])
    angle = 0.0
    for i in range(501, 560):
        angle += 0.1 * 0.01  # a positive turn about x lifts the push axis
        accel = (0.0, 9.80665 * math.sin(angle), 9.80665 * math.cos(angle))
        of.advance(Step(i * 10**7, 0.01, accel, (0.1, 0.0, 0.0), accel), belief, settings, 0.0)
    assert of.acceleration_m_s2 == pytest.approx(0.0, abs=1e-6)


def finished_push(value_m: float | None, stroke_s: float, **settings: float) -> Track:
    """A push of the usual speed for `stroke_s`, without bursts in the acceleration, to its end."""
    of, estimator = track(**settings)
    play(of, Belief(), estimator, 0.0, 5.0, 0.0 if value_m is not None else None)
    motion = Motion(1, 5 * S, confirmed=True, stop_ns=round((5 + stroke_s) * S), stop_confirmed=True)
    play(of, Belief([motion]), estimator, 5.0, 5.0 + stroke_s)
    play(of, Belief([motion]), estimator, 5.0 + stroke_s, 7.0 + stroke_s, value_m)
    return of


def stopped_in_vibration(hertz: float, phase: float, rms_m_s2: float) -> float:
    """Error of the end of a short push over its sigma: the speed is known well, a floor shakes while it stops."""
    of, settings = track(speed_sigma_machine=0.001, speed_sigma_cycle=0.001)
    play(of, Belief(), settings, 0.0, 5.0)
    speed = of.usual_speed(1)
    motion = Motion(1, 5 * S, confirmed=True, stop_ns=8 * S, stop_confirmed=True)
    true_m = 0.0
    for i in range(501, 900):
        t_s, began_s = 0.01 * i, 0.01 * (i - 1)
        # Even acceleration for 0.2 s at either end.
        before, now = (speed * (np.clip((t - 5) / 0.2, 0, 1) - np.clip((t - 8) / 0.2, 0, 1)) for t in (began_s, t_s))
        true_m += 0.005 * (before + now)
        shaken = [math.sqrt(2) * rms_m_s2 * math.sin(2 * math.pi * hertz * t + phase) for t in (began_s, t_s)]
        accel = (0.0, (now - before) / 0.01 + 0.5 * sum(shaken), 9.80665)
        level = rms_m_s2 if 5.0 < t_s < 8.2 else 0.0
        of.advance(
            Step(i * 10**7, 0.01, accel, (0.0,) * 3, accel, vibration_m_s2=level), Belief([motion]), settings, 0.0
        )
    assert of.phase is Phase.REST
    return (of.filter.state.x[P] - true_m) / of.filter.state.sigma(P)


def test_the_end_of_a_move_is_honest_though_the_floor_shakes_while_it_stops() -> None:
    # Vibration from 5 to 60 Hz has the velocity of a tone of 1 / (2 pi 0.0092 s) = 17.3 Hz.
    phases = np.random.default_rng(1).uniform(0, 2 * np.pi, 100)
    off = np.array([stopped_in_vibration(17.3, phase, 0.3) for phase in phases])
    assert np.mean(off**2) < 1.4  # of a consistent filter with probability 0.996 at most
    assert np.abs(off).max() < 4.0


def test_a_stop_is_not_believed_without_evidence() -> None:
    of = finished_push(None, 34.4)
    assert of.ending is not None
    assert of.ending.end_m == of.ending.end_before_stop_m
    assert of.pushes_learned == 0


def test_a_stop_is_believed_once_the_flow_is_learned() -> None:
    of, settings = track()
    of.pushes_learned = 1
    of.filter.state.reset(PUSH_FLOW, 0.01453, 1e-9)
    play(of, Belief(), settings, 0.0, 5.0)
    motion = Motion(1, 5 * S, confirmed=True, stop_ns=round(39.4 * S), stop_confirmed=True)
    play(of, Belief([motion]), settings, 5.0, 41.0)
    assert of.ending is not None
    if abs(of.ending.end_before_stop_m - 0.5) < 3 * of.ending.sigma_before_stop_m:
        assert of.ending.end_m == pytest.approx(0.5, abs=0.001)
        assert of.ending.sigma_m < 0.001
        assert of.pushes_learned == 2


def test_nothing_is_known_of_a_copy_that_went_on() -> None:
    of, settings = track()
    play(of, Belief(), settings, 0.0, 3.0)
    before = of.copy()
    other = of.copy()
    play(other, Belief([Motion(1, 3 * S, confirmed=True)]), settings, 3.0, 6.0)
    assert of == before
    assert other.started == 1
    assert other.filter.state.x[SPEED] == pytest.approx(0.01453, rel=0.1)


def test_a_reading_outside_the_gate_is_refused_and_told() -> None:
    of, settings = track()
    play(of, Belief(), settings, 0.0, 3.0)
    step = Step(round(3.01 * S), 0.01, GRAVITY, (0.0,) * 3, GRAVITY)
    step.readings = [Reading(step.t_ns, v, variance_m2=1e-5) for v in (0.002, 0.1)]
    step.readings.append(Reading(step.t_ns, 0.0, usable=False))
    p_m = of.filter.state.x[P]
    assert of.advance(step, Belief(), settings, 0.0) == [True, False]
    assert of.innovation_m == pytest.approx(0.1, abs=0.002)
    assert 0.0 < of.gate_m < 0.1
    assert of.filter.state.x[P] == pytest.approx(p_m, abs=0.002)


def test_rest_levels_a_sensor_that_has_been_tilted_within_seconds() -> None:
    of, settings = track()
    play(of, Belief(), settings, 0.0, 5.0)
    tilted = (0.0, 9.80665 * math.sin(0.02), 9.80665 * math.cos(0.02))
    felt = []
    for i in range(501, 1401):
        of.advance(Step(i * 10**7, 0.01, tilted, (0.0,) * 3, tilted), Belief(), settings, 0.0)
        felt.append(of.acceleration_m_s2)
    # Without a rate that told of it, the tilt fades with the time constant of the level, 3 s.
    assert felt[0] == pytest.approx(9.80665 * 0.02, rel=0.01)
    assert felt[299] == pytest.approx(felt[0] / math.e, rel=0.02)
    assert felt[-1] < 0.06 * felt[0]
