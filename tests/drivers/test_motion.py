"""Motion of the virtual support, judged by its own arrays and by scipy."""

from __future__ import annotations

from functools import cache
from itertools import pairwise, repeat

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from drivers.virtual.motion import (
    GRAVITY,
    RATE_HZ,
    Machine,
    PlannedMove,
    Scenario,
    Trajectory,
    full_cycle,
)
from drivers.virtual.scenarios import SCENARIOS

Floats = NDArray[np.float64]
STILL = Scenario(vibration_m_s2=(0.0, 0.0), tilt_deg=(0.0, 0.0), tilt_step_deg=0.0)
SEEDS = range(5)
seeds = pytest.mark.parametrize("seed", SEEDS)


def machine(seed: int, scenario: Scenario | None = None) -> Machine:
    return Machine(np.random.default_rng(seed), scenario or Scenario())


@cache
def cycle(seed: int, scenario: Scenario | None = None) -> Trajectory:
    return machine(seed, scenario).trajectory(full_cycle(), 10.0)


@seeds
def test_a_cycle_goes_from_stop_to_stop_within_their_scatter(seed: int) -> None:
    run = cycle(seed)
    push, retract = run.moves
    assert run.displacement_m[0] == 0.0
    between = run.displacement_m[np.searchsorted(run.t_s, push.stop_s + 5.0)]
    # The stop scatters by 0.5 mm; the solved stopping time leaves hundredths of a millimetre.
    assert between == pytest.approx(0.5, abs=4 * 0.0005)
    assert between == pytest.approx(push.end_m, abs=5e-5)
    assert run.displacement_m[-1] == pytest.approx(retract.end_m, abs=1e-4)
    assert retract.start_m == push.end_m


@seeds
def test_the_ram_moves_between_the_stated_times_and_rests_outside(seed: int) -> None:
    run = cycle(seed)
    for move in run.moves:
        at_speed = np.abs(run.velocity_m_s) > 0.5 * abs(move.speed_m_s)
        moving = run.t_s[at_speed & (run.t_s > move.onset_s - 1) & (run.t_s < move.stop_s + 1)]
        # Half the speed is reached, and lost again, within the burst: ramp and half a swing of 5 Hz.
        assert 0.0 < moving[0] - move.onset_s < 0.16
        assert 0.0 < moving[-1] - move.stop_s < 0.25
    first, second = run.moves
    assert first.onset_s == 10.0
    assert second.onset_s == pytest.approx(first.stop_s + 1.0 + 20.0)
    quiet = (run.t_s < 10.0) | (run.t_s > second.stop_s + 5.0)
    assert np.abs(run.velocity_m_s[quiet]).max() < 1e-5


@seeds
def test_displacement_velocity_and_acceleration_are_derivatives_of_each_other(seed: int) -> None:
    run = cycle(seed, STILL)
    np.testing.assert_allclose(np.gradient(run.displacement_m, run.t_s), run.velocity_m_s, atol=2e-4)
    # Acceleration integrates to the velocity.
    integral = np.concatenate([[0.0], np.cumsum((run.accel_m_s2[1:, 1] + run.accel_m_s2[:-1, 1]) / 2)]) / RATE_HZ
    np.testing.assert_allclose(integral, run.velocity_m_s, atol=5e-5)
    # Beside the push only the flutter of the tilt is felt: 0.003 degrees of gravity.
    assert np.std(run.accel_m_s2[:, 0]) == pytest.approx(GRAVITY * np.radians(0.003), rel=0.1)
    np.testing.assert_allclose(run.accel_m_s2[:, 2], GRAVITY, rtol=2e-5)


def test_bursts_are_second_order_responses_to_a_ramp() -> None:
    for burst in (machine(1).start, machine(1).hard_stop, machine(2).valve_stop):
        t_s = np.arange(0.0, 3.0, 1e-4)
        w, z = 2 * np.pi * burst.frequency_hz, burst.damping
        system = ([w * w], [1.0, 2 * z * w, w * w])
        _, expected, _ = signal.lsim(system, np.clip(t_s / burst.ramp_s, 0.0, 1.0), t_s)
        value, slope = burst.response(t_s)
        np.testing.assert_allclose(value, expected, atol=1e-5)
        np.testing.assert_allclose(slope[1:-1], np.gradient(expected, t_s)[1:-1], atol=0.02)
        before, before_slope = burst.response(np.array([-1.0, -1e-9]))
        assert not before.any()
        assert not before_slope.any()
        # The area between the step and the response is its lag.
        assert np.sum(1.0 - value) * 1e-4 == pytest.approx(burst.lag_s, abs=1e-3)


def test_speeds_scatter_by_machine_and_by_move() -> None:
    pushes, ratios = [], []
    script = (PlannedMove(1.0, 0.05, 0.01453), PlannedMove(1.0, 0.0, 0.01453))
    for seed in range(60):
        there, back = machine(seed, STILL).trajectory(script, 1.0).moves
        pushes.append(there.speed_m_s / 0.01453)
        ratios.append(-there.speed_m_s / back.speed_m_s)
    # Standard deviations of 60 values are known to 9 %.
    assert np.mean(pushes) == pytest.approx(1.0, abs=4 * 0.025 / np.sqrt(60))
    assert np.std(pushes) == pytest.approx(np.hypot(0.02, 0.015), rel=0.3)
    assert np.std(ratios) == pytest.approx(np.sqrt(2) * 0.015, rel=0.3)


def test_velocity_of_a_push_ripples_about_its_mean() -> None:
    run = cycle(3, STILL)
    move = run.moves[0]
    cruise = run.velocity_m_s[(run.t_s > move.onset_s + 2) & (run.t_s < move.stop_s - 0.1)]
    assert np.mean(cruise) == pytest.approx(move.speed_m_s, rel=0.008)
    assert 0.003 < np.std(cruise) / move.speed_m_s < 0.02


@seeds
def test_vibration_has_its_level_in_motion_and_an_eighth_of_it_at_rest(seed: int) -> None:
    scenario = Scenario(vibration_m_s2=(0.2, 0.2), tilt_deg=(0.0, 0.0), tilt_step_deg=0.0)
    run = cycle(seed, scenario)
    move = run.moves[0]
    moving = (run.t_s > move.onset_s + 1) & (run.t_s < move.stop_s - 1)
    rest = (run.t_s > 1) & (run.t_s < move.onset_s - 0.5)
    across, along, up = np.std(run.accel_m_s2[moving], axis=0)
    # Its level itself wanders (log-normal, 0.3, over 1 s): rms exp(0.09) times as large, known to some 10 %.
    expected = 0.2 * np.exp(0.3**2)
    assert along == pytest.approx(expected, rel=0.25)
    assert across / along == pytest.approx(0.7, rel=0.05)
    assert up / along == pytest.approx(0.9, rel=0.05)
    # One second of wander in a rest of nine: nine independent levels.
    assert np.std(run.accel_m_s2[rest, 1]) == pytest.approx(0.12 * expected, rel=0.4)


@pytest.mark.parametrize("band", [(5.0, 60.0), (2.0, 30.0)])
def test_vibration_lies_in_its_band(band: tuple[float, float]) -> None:
    scenario = Scenario(vibration_m_s2=(0.2, 0.2), vibration_band_hz=band, tilt_deg=(0.0, 0.0), tilt_step_deg=0.0)
    run = cycle(1, scenario)
    f, power = signal.welch(run.accel_m_s2[:, 0], RATE_HZ, nperseg=4096)
    inside = (f >= band[0] - 0.5) & (f <= band[1] + 0.5)
    assert power[inside].sum() / power.sum() > 0.97
    flat = power[(f > band[0] + 1) & (f < band[1] - 1)]
    assert np.std(flat) / np.mean(flat) < 0.5  # white within: 33 averaged periodograms


def test_rest_shakes_as_much_as_motion_where_the_scenario_says_so() -> None:
    run = cycle(2, Scenario(vibration_m_s2=(0.2, 0.2), vibration_at_rest=1.0))
    rest = np.std(run.accel_m_s2[run.t_s < 9.0, 0])
    moving = np.std(run.accel_m_s2[(run.t_s > 12.0) & (run.t_s < 40.0), 0])
    assert rest == pytest.approx(moving, rel=0.4)


def angles(run: Trajectory) -> Floats:
    """Pitch and roll [rad] from the rates."""
    rates = run.gyro_rad_s[:, :2]
    return np.asarray(np.cumsum(rates, axis=0) / RATE_HZ)


def test_tilt_wanders_while_moving_by_the_drawn_amount_and_stands_at_rest() -> None:
    scenario = Scenario(vibration_m_s2=(0.0, 0.0), tilt_deg=(0.2, 0.2), tilt_step_deg=0.0)
    spread = []
    for seed in range(12):
        run = cycle(seed, scenario)
        tilt = angles(run)
        first, second = run.moves
        moving = (run.t_s > first.onset_s) & (run.t_s < first.stop_s)
        spread.append(np.std(tilt[moving], axis=0))
        still = (run.t_s > first.stop_s + 1.0) & (run.t_s < second.onset_s)
        assert np.degrees(np.std(tilt[still], axis=0)).max() < 0.006  # flutter of 0.003 degrees alone
    # An Ornstein-Uhlenbeck process of 5 s seen for 33 s shows about four fifths of its spread.
    assert np.degrees(np.sqrt(np.mean(np.square(spread)))) == pytest.approx(0.16, rel=0.3)


def test_tilt_steps_at_each_start_and_stop() -> None:
    scenario = Scenario(vibration_m_s2=(0.0, 0.0), tilt_deg=(0.0, 0.0), tilt_step_deg=0.04)
    steps = []
    for seed in range(15):
        run = cycle(seed, scenario)
        tilt = angles(run)
        for t_s in (t for move in run.moves for t in (move.onset_s, move.stop_s)):
            before = tilt[(run.t_s > t_s - 1.0) & (run.t_s < t_s)].mean(axis=0)
            after = tilt[(run.t_s > t_s + 1.0) & (run.t_s < t_s + 2.0)].mean(axis=0)
            steps.append(np.degrees(after - before))
    # 120 steps: their spread is known to 6.5 %.
    assert np.std(steps) == pytest.approx(0.04, rel=0.25)


def test_what_is_felt_is_gravity_in_tilted_axes() -> None:
    scenario = Scenario(vibration_m_s2=(0.0, 0.0), tilt_deg=(0.3, 0.3))
    run = cycle(4, scenario)
    rest = run.t_s > run.moves[-1].stop_s + 3.0
    felt = run.accel_m_s2[rest]
    np.testing.assert_allclose(np.linalg.norm(felt, axis=1), GRAVITY, rtol=1e-5)
    pitch, roll = angles(run)[rest].T
    # A turn about x lifts the push axis; the flutter at the start is all that the integral does not know.
    np.testing.assert_allclose(felt[:, 1], GRAVITY * np.sin(pitch), atol=GRAVITY * np.radians(0.02))
    np.testing.assert_allclose(felt[:, 0], -GRAVITY * np.sin(roll), atol=GRAVITY * np.radians(0.02))


@seeds
def test_same_seed_gives_the_same_arrays_and_another_seed_others(seed: int) -> None:
    one, two = machine(seed).trajectory(full_cycle(), 1.0), machine(seed).trajectory(full_cycle(), 1.0)
    other = machine(seed + 100).trajectory(full_cycle(), 1.0)
    assert one.moves == two.moves != other.moves
    for name in ("t_s", "displacement_m", "velocity_m_s", "accel_m_s2", "gyro_rad_s", "temperature_c"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_arrays_fit_together() -> None:
    run = cycle(0)
    n = len(run.t_s)
    assert run.displacement_m.shape == run.velocity_m_s.shape == run.temperature_c.shape == (n,)
    assert run.accel_m_s2.shape == run.gyro_rad_s.shape == (n, 3)
    np.testing.assert_allclose(np.diff(run.t_s), 1 / RATE_HZ)
    assert run.temperature_c[0] == 25.0
    assert run.temperature_c[-1] == pytest.approx(25.5)


def test_a_machine_goes_on_where_its_last_script_ended() -> None:
    mover = machine(6, STILL)
    first = mover.trajectory((PlannedMove(1.0, 0.2, 0.01453, hard_stop=False),), 3.0)
    assert mover.position_m == 0.2
    second = mover.trajectory((PlannedMove(1.0, 0.05, 0.03519, hard_stop=False),), 3.0)
    assert second.displacement_m[0] == 0.2
    assert first.displacement_m[-1] == pytest.approx(0.2, abs=1e-4)
    assert second.displacement_m[-1] == pytest.approx(0.05, abs=1e-4)
    assert second.moves[0].speed_m_s < 0


def test_endless_cycles_repeat_the_script_with_new_scatter() -> None:
    script = (PlannedMove(1.0, 0.05, 0.01453), PlannedMove(1.0, 0.0, 0.03519))
    cycles = machine(7).play(repeat(script), 1.0)
    runs = [next(cycles) for _ in range(3)]
    assert len({run.moves for run in runs}) == 3
    for run, following in pairwise(runs):
        assert following.displacement_m[0] == run.moves[-1].end_m
        np.testing.assert_allclose(following.accel_m_s2[:50, :2].mean(0), run.accel_m_s2[-50:, :2].mean(0), atol=0.03)


def test_the_bench_is_far_quieter_than_the_face() -> None:
    bench, face = (cycle(1, SCENARIOS[name]) for name in ("lab_bench", "nominal"))
    moving = slice(int(12 * RATE_HZ), int(40 * RATE_HZ))
    assert np.std(bench.accel_m_s2[moving, 0]) < 0.025
    assert np.std(face.accel_m_s2[moving, 0]) > 2 * np.std(bench.accel_m_s2[moving, 0])
