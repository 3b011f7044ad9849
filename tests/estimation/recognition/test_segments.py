"""Velocity steps and the recognition of moves, on block means of synthetic motion in the part's own white noise."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from drivers.virtual.motion import Machine, PlannedMove, Scenario, TrueMove
from estimation.recognition.kernels import SPECS, Kernel
from estimation.recognition.motion import Context, Decision, Motion
from estimation.recognition.segments import SegmentRecogniser
from estimation.recognition.step_evidence import evidence
from estimation.recognition.steps import Block, StepBank, Steps
from tests.estimation.support import ramp_response

Floats = NDArray[np.float64]
DT_S = 8 / 819.2
CONTEXT = Context(push_speed=0.01453, retract_speed=0.03519)
PUSH, RETRACT = PlannedMove(8.0, 0.12, 0.01453), PlannedMove(8.0, 0.0, 0.03519)
# As much of the sensor's white noise as a mean over eight samples keeps.
ACCEL_NOISE, GYRO_NOISE = 0.0456 / math.sqrt(8), math.radians(0.0135) * math.sqrt(819.2 / 2 / 8)


@dataclass(frozen=True)
class Noticed:
    t_s: float
    decision: Decision
    motion: Motion | None


def blocks_of(push_m_s2: Floats, tilt_rate: Floats, seed: int, noise: float = 1.0) -> list[Block]:
    rng = np.random.default_rng(seed)
    push_m_s2 = push_m_s2 + noise * rng.normal(0.0, ACCEL_NOISE, len(push_m_s2))
    tilt_rate = tilt_rate + noise * rng.normal(0.0, GYRO_NOISE, len(tilt_rate))
    return [
        Block(round((i + 1) * DT_S * 1e9), a, w, 9.80665)
        for i, (a, w) in enumerate(zip(push_m_s2.tolist(), tilt_rate.tolist(), strict=True))
    ]


def block_means(values: Floats) -> Floats:
    return np.asarray(values[: len(values) // 8 * 8].reshape(-1, 8).mean(axis=1))


def recognised(blocks: Sequence[Block], context: Context = CONTEXT) -> tuple[list[Noticed], list[Steps]]:
    """What bank and recogniser say to a stream, joined as the pipeline joins them."""
    bank, recogniser = StepBank(DT_S), SegmentRecogniser()
    noticed, statistics = [], []
    for block in blocks:
        steps = bank.add(
            block,
            0.0,
            since_event_s=recogniser.since_event_s(block.t_ns),
            resting=recogniser.resting,
        )
        statistics.append(steps)
        if block.t_ns < 3e9:
            continue
        decision = recogniser.update(block.t_ns, steps, bank, context)
        if decision is not None:
            noticed.append(Noticed(block.t_ns * 1e-9, decision, recogniser.motion))
        if decision in (Decision.STOP_CONFIRMED, Decision.STOP_UNSTARTED):
            recogniser.motion = None
    return noticed, statistics


@cache
def machine_run(
    seed: int, script: tuple[PlannedMove, ...] = (PUSH, RETRACT), scenario: Scenario | None = None
) -> tuple[tuple[TrueMove, ...], tuple[Noticed, ...]]:
    trajectory = Machine(np.random.default_rng(seed), scenario or Scenario()).trajectory(script, 5.0)
    blocks = blocks_of(block_means(trajectory.accel_m_s2[:, 1]), block_means(trajectory.gyro_rad_s[:, 0]), seed)
    return trajectory.moves, tuple(recognised(blocks)[0])


def of(noticed: Iterable[Noticed], decision: Decision) -> list[Noticed]:
    return [item for item in noticed if item.decision is decision]


@pytest.mark.parametrize("seed", range(6))
def test_both_moves_are_found_in_the_right_direction_and_at_the_right_time(seed: int) -> None:
    moves, noticed = machine_run(seed)
    starts, stops = of(noticed, Decision.START_CONFIRMED), of(noticed, Decision.STOP_CONFIRMED)
    assert [item.motion.direction for item in starts if item.motion] == [1, -1]
    assert len(stops) == 2
    for move, start, stop in zip(moves, starts, stops, strict=True):
        assert start.motion is not None
        assert stop.motion is not None
        assert stop.motion.stop_ns is not None
        assert stop.motion.onset_ns == start.motion.onset_ns
        assert start.motion.onset_ns * 1e-9 == pytest.approx(move.onset_s, abs=0.06)
        assert stop.motion.stop_ns * 1e-9 == pytest.approx(move.stop_s, abs=0.08)
        # Confirmed within the time that the pipeline's buffer covers.
        assert start.t_s - move.onset_s < 1.1
        assert stop.t_s - move.stop_s < 1.6


def test_proposals_come_within_a_fraction_of_a_second() -> None:
    delays = []
    for seed in range(6):
        moves, noticed = machine_run(seed)
        starts, stops = of(noticed, Decision.START_PROPOSED), of(noticed, Decision.STOP_PROPOSED)
        delays += [s.t_s - m.onset_s for m, s in zip(moves, starts, strict=True)]
        delays += [s.t_s - m.stop_s for m, s in zip(moves, stops, strict=True)]
    assert min(delays) > 0.0
    assert np.median(delays) < 0.2
    assert max(delays) < 0.5


def test_time_errors_scatter_by_milliseconds_only() -> None:
    errors = []
    for seed in range(6):
        moves, noticed = machine_run(seed)
        for move, item in zip(moves, of(noticed, Decision.STOP_CONFIRMED), strict=True):
            assert item.motion is not None
            assert item.motion.stop_ns is not None
            errors.append((item.motion.onset_ns * 1e-9 - move.onset_s, item.motion.stop_ns * 1e-9 - move.stop_s))
    assert np.median(np.abs(errors), axis=0).max() < 0.025


def test_moves_are_found_when_rest_shakes_as_hard_as_motion() -> None:
    loud = Scenario(vibration_m_s2=(0.2, 0.2), vibration_at_rest=1.0)
    for seed in range(20, 23):
        moves, noticed = machine_run(seed, scenario=loud)
        stops = of(noticed, Decision.STOP_CONFIRMED)
        assert [item.motion.direction for item in stops if item.motion] == [1, -1]
        for move, item in zip(moves, stops, strict=True):
            assert item.motion is not None
            assert item.motion.onset_ns * 1e-9 == pytest.approx(move.onset_s, abs=0.1)


def test_a_step_has_the_size_of_the_speed_and_the_stated_sigma() -> None:
    trajectory = Machine(np.random.default_rng(3), Scenario(vibration_m_s2=(0.05, 0.05))).trajectory(
        (PlannedMove(8.0, 0.05, 0.01453),), 3.0
    )
    answers = []
    for seed in range(8):
        blocks = blocks_of(
            block_means(trajectory.accel_m_s2[:, 1]), block_means(trajectory.gyro_rad_s[:, 0]), 100 + seed
        )
        _, statistics = recognised(blocks[: int(9.2 / DT_S)])
        k = 2  # sees 0.7 s of the burst
        step = max(statistics[int(8.5 / DT_S) :], key=lambda s: s.x[k])
        answers.append((step.x[k] - trajectory.moves[0].speed_m_s, step.sigma[k]))
    errors, sigmas = np.array(answers).T
    assert np.abs(errors / sigmas).max() < 3.0
    assert sigmas.max() < 0.002


@pytest.mark.parametrize("seed", [1, 2])
def test_minutes_of_pure_noise_start_no_move(seed: int) -> None:
    n = int(300 / DT_S)
    noticed, _ = recognised(blocks_of(np.zeros(n), np.zeros(n), seed))
    assert of(noticed, Decision.START_CONFIRMED) == []
    assert len(of(noticed, Decision.START_PROPOSED)) <= 1


@pytest.mark.parametrize("seed", [0, 2])
def test_a_deep_but_short_dip_is_not_a_stop_either(seed: int) -> None:
    # As large as a stop may look; that the speed comes back within half a second tells it from one.
    push = np.zeros(int(30 / DT_S))
    for at_s, by_m_s in ((8.0, 0.0145), (14.0, -0.0105), (14.4, 0.0105), (20.0, -0.0145)):
        i = int(at_s / DT_S)
        push[i : i + 20] += by_m_s / (20 * DT_S)
    noticed, _ = recognised(blocks_of(push, np.zeros(len(push)), seed))
    assert [item.decision for item in noticed][2:] == [
        Decision.STOP_PROPOSED,
        Decision.STOP_DISCARDED,
        Decision.STOP_PROPOSED,
        Decision.STOP_CONFIRMED,
    ]
    assert noticed[-1].motion is not None
    assert noticed[-1].motion.stop_ns is not None
    assert noticed[-1].motion.stop_ns * 1e-9 == pytest.approx(20.0, abs=0.15)


@pytest.mark.parametrize(("rise", "hold"), [(3, 0), (5, 5), (10, 5)])
def test_a_bump_that_leaves_no_velocity_is_discarded(rise: int, hold: int) -> None:
    push = np.zeros(int(20 / DT_S))
    at = int(10 / DT_S)
    push[at : at + rise] += 0.0145 / (rise * DT_S)  # 14.5 mm/s gained within 0.1 s ...
    push[at + rise + hold : at + 2 * rise + hold] -= 0.0145 / (rise * DT_S)  # ... and soon lost again
    noticed, _ = recognised(blocks_of(push, np.zeros(len(push)), 5))
    words = [item.decision for item in noticed]
    assert words == [Decision.START_PROPOSED, Decision.START_DISCARDED]
    assert noticed[-1].motion is None


def test_turning_the_sensor_is_not_a_start() -> None:
    # 0.1 degrees within 0.3 s put 17 mm/s^2 of gravity on the push axis; the gyro tells.
    n = int(20 / DT_S)
    angle = np.radians(0.1) * np.clip((np.arange(n) * DT_S - 10.0) / 0.3, 0, 1)
    rate = np.gradient(angle, DT_S)
    tilted = blocks_of(9.80665 * np.sin(np.cumsum(rate) * DT_S), rate, 6)
    assert of(recognised(tilted)[0], Decision.START_CONFIRMED) == []


def test_a_mere_dip_of_the_speed_is_not_a_stop() -> None:
    n = int(30 / DT_S)
    push = np.zeros(n)

    def change(at_s: float, by_m_s: float, over_s: float = 0.2) -> None:
        i, m = int(at_s / DT_S), int(over_s / DT_S)
        push[i : i + m] += by_m_s / (m * DT_S)

    change(8.0, 0.0145)
    change(14.0, -0.007)  # down to half ...
    change(14.4, 0.007)  # ... and back
    change(20.0, -0.0145)
    noticed, _ = recognised(blocks_of(push, np.zeros(n), 7))
    stops = of(noticed, Decision.STOP_CONFIRMED)
    assert len(of(noticed, Decision.START_CONFIRMED)) == 1
    assert len(stops) == 1
    assert stops[0].motion is not None
    assert stops[0].motion.stop_ns is not None
    assert stops[0].motion.stop_ns * 1e-9 == pytest.approx(20.0, abs=0.15)
    assert len(of(noticed, Decision.STOP_PROPOSED)) == 1 + len(of(noticed, Decision.STOP_DISCARDED))


def test_a_slow_start_is_heard_by_the_wide_kernel() -> None:
    t_s = np.arange(int(20 / DT_S) * 8 + 1) * DT_S / 8
    velocity = 0.01453 * ramp_response(2.2, 0.7, 0.5, t_s - 8.0)
    push = np.diff(velocity[::8]) / DT_S
    noticed, _ = recognised(blocks_of(push, np.zeros(len(push)), 1))
    starts = of(noticed, Decision.START_CONFIRMED)
    assert len(starts) == 1
    assert starts[0].motion is not None
    assert starts[0].motion.slow
    assert starts[0].motion.direction == 1
    assert starts[0].motion.onset_ns * 1e-9 == pytest.approx(8.0, abs=0.15)


def test_a_direction_that_the_position_forbids_needs_more_evidence_but_is_not_impossible() -> None:
    n = int(14 / DT_S)

    def proposed_at(size_m_s: float, context: Context) -> float | None:
        push = np.zeros(n)
        push[820:840] = size_m_s / (20 * DT_S)
        noticed = of(recognised(blocks_of(push, np.zeros(n), 9), context)[0], Decision.START_PROPOSED)
        return noticed[0].t_s if noticed else None

    forbidden = replace(CONTEXT, push_forbidden=True)
    free, hindered = proposed_at(0.0145, CONTEXT), proposed_at(0.0145, forbidden)
    assert free is not None
    assert hindered is not None
    assert hindered >= free
    # A step of half the speed is a start only where it is allowed to be one.
    assert CONTEXT.penalty(1) == CONTEXT.penalty(-1) == 0.0
    assert forbidden.penalty(1) > 10.0
    assert forbidden.penalty(-1) == 0.0
    assert replace(CONTEXT, retract_forbidden=True).penalty(-1) > 10.0


@pytest.mark.parametrize("x", [-0.01, 0.0, 0.004, 0.0145, 0.02])
@pytest.mark.parametrize("sigma", [0.0005, 0.003])
def test_evidence_is_the_difference_of_two_log_densities(x: float, sigma: float) -> None:
    none = math.hypot(1.15 * sigma, 0.0004)
    step = math.hypot(none, 0.13 * 0.0145)
    expected = norm.logpdf(x, 0.0145, step) - norm.logpdf(x, 0.0, none)
    assert evidence(x, sigma, 0.0145, 0.13) == pytest.approx(expected, rel=1e-9)


def test_vibration_level_is_that_of_the_band_noise() -> None:
    rng = np.random.default_rng(11)
    fine, n = 10, 4000
    spectrum = np.fft.rfft(rng.normal(size=n * fine))
    f = np.fft.rfftfreq(n * fine, DT_S / fine)
    spectrum[(f < 5) | (f > 60)] = 0.0
    noise = np.fft.irfft(spectrum)
    noise *= 0.2 / np.std(noise)
    bank = StepBank(DT_S)
    levels = []
    for block in blocks_of(noise.reshape(n, fine).mean(axis=1), np.zeros(n), 12):
        bank.add(block, 0.0, since_event_s=10.0, resting=True)
        levels.append(bank.vibration_m_s2)
    assert np.sqrt(np.mean(np.square(levels[500:]))) == pytest.approx(0.2, rel=0.1)


def test_white_noise_alone_is_hardly_any_vibration() -> None:
    bank = StepBank(DT_S)
    n = 3000
    levels = []
    for block in blocks_of(np.zeros(n), np.zeros(n), 13):
        bank.add(block, 0.0, since_event_s=10.0, resting=True)
        levels.append(bank.vibration_m_s2)
    assert np.mean(levels) < 0.012


@pytest.mark.parametrize("dt_s", [0.08, 0.32, 0.8])
def test_statistics_of_a_slow_source_stay_finite(dt_s: float) -> None:
    rng = np.random.default_rng(14)
    bank = StepBank(dt_s)
    for i, a in enumerate(rng.normal(0.0, 0.1, 600).tolist()):
        block = Block(round(i * dt_s * 1e9), a, 0.0, 9.8)
        steps = bank.add(block, 0.0, since_event_s=10.0, resting=True)
    assert np.isfinite([*steps.x, *steps.sigma, bank.vibration_m_s2]).all()
    assert bank.vibration_m_s2 < 0.5


def test_bank_says_nothing_before_its_kernels_are_full() -> None:
    bank = StepBank(DT_S)
    push = np.zeros(120)
    push[30:] = 1.0
    for block in blocks_of(push, np.zeros(120), 15):
        steps = bank.add(block, 0.0, since_event_s=10.0, resting=True)
    assert steps == Steps((0.0,) * len(SPECS), (1.0,) * len(SPECS))


def test_event_time_lies_as_far_back_as_the_kernel_looks() -> None:
    bank = StepBank(DT_S)
    times = []
    for block in blocks_of(np.zeros(400), np.zeros(400), 16):
        bank.add(block, 0.0, since_event_s=10.0, resting=True)
        times.append(block.t_ns)
    for k, post in enumerate(bank.post_steps):
        assert post == round(SPECS[Kernel(k)].post_s / DT_S)
        assert bank.event_time_ns(k) == times[-1 - post]
        assert bank.event_time_ns(k, ago=3) == times[-4 - post]
    assert bank.event_time_ns(0, ago=10**6) == times[-bank.depth]


def test_scattered_losses_are_filled_once_they_add_up_to_a_block() -> None:
    bank = StepBank(DT_S)
    n = 200
    times = [round(i * 1.12 * DT_S * 1e9) for i in range(n)]  # every block 12 % too long
    for t_ns, block in zip(times, blocks_of(np.zeros(n), np.zeros(n), 3), strict=True):
        bank.keep_pace(t_ns, DT_S)
        bank.add(replace(block, t_ns=t_ns), 0.0, since_event_s=10.0, resting=True)
    seen_s = (bank.times_ns[-1] - bank.event_time_ns(3)) * 1e-9
    assert seen_s == pytest.approx(SPECS[Kernel(3)].post_s, abs=2 * DT_S)
    assert list(bank.times_ns) == sorted(bank.times_ns)


def test_a_bridged_gap_keeps_the_blocks_behind_it_in_their_places() -> None:
    # A push whose burst is over when eleven blocks are lost: the step is seen as if none were.
    n = int(12 / DT_S)
    push = np.zeros(n)
    push[820:840] = 0.01453 / (20 * DT_S)
    whole, gapped = StepBank(DT_S), StepBank(DT_S)
    blocks = blocks_of(push, np.zeros(n), 17, noise=0.0)
    whole_x, gapped_x = [], []
    for i, block in enumerate(blocks):
        whole_x.append(whole.add(block, 0.0, since_event_s=10.0, resting=False).x)
        if not 845 <= i < 856:
            gapped.keep_pace(block.t_ns, DT_S)
            gapped_x.append(gapped.add(block, 0.0, since_event_s=10.0, resting=False).x)
            assert gapped.event_time_ns(2) == pytest.approx(whole.event_time_ns(2), abs=20)
    np.testing.assert_allclose(gapped_x[845:], whole_x[856:], atol=1e-12)


def test_recogniser_looks_for_the_true_stop_of_a_reopened_move() -> None:
    recogniser = SegmentRecogniser()
    motion = Motion(1, 10**10, confirmed=True)
    recogniser.reopen(motion, 2 * 10**10)
    assert recogniser.motion == motion
    assert not recogniser.resting
    assert recogniser.ignore_before_ns == 19 * 10**9
    recogniser.rest(3 * 10**10)
    assert recogniser.resting
    assert recogniser.since_event_s(3 * 10**10 + 10**9) == pytest.approx(1.0)
