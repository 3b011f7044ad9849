from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.virtual.inertial_input import InertialBlock
from drivers.virtual.motion import GRAVITY, RATE_HZ, PlannedMove, Scenario
from drivers.virtual.support import SupportInput, VirtualSupport

Floats = NDArray[np.float64]
SCRIPT = (PlannedMove(1.0, 0.03, 0.01453), PlannedMove(1.0, 0.0, 0.03519))
STILL = Scenario(vibration_m_s2=(0.0, 0.0), tilt_deg=(0.0, 0.0), tilt_step_deg=0.0)


def support(seed: int = 1, cycles: int | None = 1, **options: object) -> VirtualSupport:
    scenario = options.pop("scenario", None)
    assert scenario is None or isinstance(scenario, Scenario)
    return VirtualSupport(seed, scenario, cycles=cycles, script=SCRIPT, **options)  # type: ignore[arg-type]  # keyword arguments of the tests


def blocks_of(source: SupportInput, at_most: int | None = None) -> list[InertialBlock]:
    blocks: list[InertialBlock] = []
    while (at_most is None or len(blocks) < at_most) and (block := source.block()) is not None:
        blocks.append(block)
    return blocks


def joined(blocks: list[InertialBlock]) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
    return (
        np.concatenate([b.t_ns for b in blocks]),
        np.concatenate([b.gyro for b in blocks]),
        np.concatenate([b.accel for b in blocks]),
        np.concatenate([b.temperature_c for b in blocks]),
    )


def test_samples_come_at_the_drawn_rate_of_the_parts_own_clock() -> None:
    rates = []
    for seed in range(12):
        virtual = support(seed)
        t_ns, *_ = joined(blocks_of(virtual.inertial_input(), 20))
        assert np.mean(np.diff(t_ns)) * 1e-9 == pytest.approx(1 / virtual.sample_rate_hz, rel=1e-6)
        assert np.ptp(np.diff(t_ns)) <= 1  # a nanosecond of rounding
        rates.append(virtual.sample_rate_hz / RATE_HZ)
    # Uniform within 3 %: the largest of 12 lies beyond half the width but for one in 4096.
    assert max(rates) <= 1.03
    assert min(rates) >= 0.97
    assert max(abs(rate - 1) for rate in rates) > 0.015


def test_start_time_is_that_asked_for_everywhere() -> None:
    start_ns = 5 * 10**12
    early, late = support(2), support(2, start_ns=start_ns)
    for name in ("observations", "reference"):
        shifted = [(t + start_ns, v) for t, v in getattr(early, name)()]
        assert list(getattr(late, name)()) == shifted
    first = late.inertial_input().block()
    assert first is not None
    assert first.t_ns[0] == start_ns


def test_the_sensor_feels_the_motion_in_its_own_axes() -> None:
    # Push along -x, up along +y of the sensor; the mounting is off by up to 3 degrees an axis.
    axes = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
    virtual = support(3, scenario=STILL, sensor_axes=axes)
    t_ns, gyro, accel, _ = joined(blocks_of(virtual.inertial_input()))
    gravity = accel[:500].mean(axis=0)
    assert np.linalg.norm(gravity) == pytest.approx(GRAVITY, rel=1e-5)
    off = np.degrees(np.arccos(gravity[1] / GRAVITY))
    assert 0.0 < off < 3.0 * np.sqrt(3)
    move = virtual.true_moves()[0]
    t_s = t_ns * 1e-9
    burst = (t_s > move.onset_s) & (t_s < move.onset_s + 0.8)
    gained = ((accel - gravity)[burst] / virtual.sample_rate_hz).sum(axis=0)
    assert np.linalg.norm(gained) == pytest.approx(move.speed_m_s, rel=0.05)
    assert gained[0] == pytest.approx(-move.speed_m_s, rel=0.05)
    assert np.abs(gyro).max() < 0.05


def test_samples_are_the_truth_at_their_instants() -> None:
    virtual = support(4, scenario=STILL, sensor_axes=np.eye(3))
    t_ns, _, accel, temperature_c = joined(blocks_of(virtual.inertial_input()))
    truth = virtual.truth()
    size = np.linalg.norm(truth.accel_m_s2, axis=1)
    np.testing.assert_allclose(np.linalg.norm(accel, axis=1), np.interp(t_ns * 1e-9, truth.t_s, size), atol=5e-4)
    np.testing.assert_allclose(temperature_c, np.interp(t_ns * 1e-9, truth.t_s, truth.temperature_c))
    assert t_ns[-1] * 1e-9 == pytest.approx(truth.t_s[-1], abs=2 / RATE_HZ)


def test_observations_are_late_by_their_latency_and_never_early() -> None:
    virtual = support(5)
    parameters, truth = virtual.controller_parameters, virtual.truth()
    readings = list(virtual.observations())
    sent_s = np.array([t for t, _ in readings]) * 1e-9
    shown = np.array([v for _, v in readings])
    assert 0.005 <= parameters.latency_s <= 0.030
    # With the true delay taken off, the readings lie on their grid within the truth.
    phase = (sent_s - parameters.latency_s) * parameters.rate_hz
    np.testing.assert_allclose(phase - np.round(phase - phase[0]), phase[0], atol=1e-5)
    assert sent_s[0] >= parameters.latency_s
    assert sent_s[-1] <= truth.t_s[-1] + parameters.latency_s
    true_m = np.interp(sent_s - parameters.latency_s, truth.t_s, truth.displacement_m)
    residual = shown - true_m - parameters.offset_m
    assert np.std(residual) == pytest.approx(parameters.sigma_m, rel=0.3)


def test_the_reference_is_the_truth() -> None:
    virtual = support(6)
    truth = virtual.truth()
    t_ns, values = np.array(list(virtual.reference())).T
    np.testing.assert_allclose(values, np.interp(t_ns * 1e-9, truth.t_s, truth.displacement_m), atol=6e-6)


@pytest.mark.parametrize("cycles", [1, 2, 3])
def test_there_are_as_many_cycles_as_asked_for(cycles: int) -> None:
    virtual = support(7, cycles)
    t_ns, *_ = joined(blocks_of(virtual.inertial_input()))
    values = np.array([v for _, v in virtual.reference()])
    pushes = np.count_nonzero((values[1:] > 0.015) & (values[:-1] <= 0.015))
    assert pushes == cycles
    assert t_ns[-1] * 1e-9 == pytest.approx(virtual.truth().t_s[-1] * cycles, rel=0.05)
    assert virtual.inertial_input().block() is not None
    assert (np.diff(t_ns) > 0).all()


def test_no_cycle_is_no_motion() -> None:
    virtual = support(8, cycles=0)
    assert virtual.inertial_input().block() is None
    assert virtual.true_moves() == ()
    assert list(virtual.observations()) == []
    with pytest.raises(ValueError, match="no truth"):
        virtual.truth()


def test_endless_cycles_join_without_a_jump() -> None:
    virtual = support(9, cycles=None, scenario=Scenario(vibration_m_s2=(0.0, 0.0), tilt_deg=(0.3, 0.3)))
    length_s = virtual.truth().t_s[-1]
    t_ns, gyro, accel, _ = joined(blocks_of(virtual.inertial_input(), int(2.5 * length_s * RATE_HZ / 256)))
    joint = int(np.searchsorted(t_ns, length_s * 1e9))
    assert joint + 500 < len(t_ns)
    # Position: the reference goes on where it was; tilt: gravity is felt in the same direction.
    values = np.array([v for _, v in islice(virtual.reference(), int(2.5 * length_s * 50))])
    assert np.abs(np.diff(values)).max() < 0.05 * 0.05
    before, after = accel[joint - 200 : joint].mean(axis=0), accel[joint : joint + 200].mean(axis=0)
    np.testing.assert_allclose(before, after, atol=GRAVITY * np.radians(0.01))
    # No rate tells of a jump either, and no sample is missing or doubled at the joint.
    assert np.abs(gyro[joint - 5 : joint + 5]).max() < 0.02
    assert np.diff(t_ns).max() * 1e-9 < 1.01 / virtual.sample_rate_hz
    assert np.diff(t_ns).min() * 1e-9 > 0.99 / virtual.sample_rate_hz


def test_consumers_at_different_pace_see_the_same_motion() -> None:
    alone, shared = support(10, 2), support(10, 2)
    expected = joined(blocks_of(alone.inertial_input()))
    expected_readings = list(alone.observations())
    # Interleaved: one block, then three readings, and so on; both run to the end.
    source, readings = shared.inertial_input(), shared.observations()
    blocks: list[InertialBlock] = []
    seen = []
    more = True
    while more:
        block = source.block()
        if block is not None:
            blocks.append(block)
        some = list(islice(readings, 3))
        seen += some
        more = block is not None or bool(some)
    for one, other in zip(joined(blocks), expected, strict=True):
        np.testing.assert_array_equal(one, other)
    assert seen == expected_readings


def test_one_seed_draws_everything_and_the_scenario_disturbs_only_the_motion() -> None:
    one, same, bench = support(11), support(11), support(11, scenario=STILL)
    assert one.controller_parameters == same.controller_parameters == bench.controller_parameters
    assert one.sample_rate_hz == bench.sample_rate_hz != support(12).sample_rate_hz
    assert one.true_moves() == same.true_moves()
    np.testing.assert_array_equal(one.sensor_errors.accel_bias, bench.sensor_errors.accel_bias)
    assert not np.array_equal(one.sensor_errors.accel_bias, support(12).sensor_errors.accel_bias)
