"""The estimator through its public face, on the virtual support's records."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.pipeline import Pipeline, Start
from estimation.records import (
    CanState,
    Displacement,
    Estimate,
    ImuSample,
    Move,
    MoveKind,
    Output,
    ReadingFault,
    Record,
    Segment,
    Tick,
    Tier,
    Vector,
)
from estimation.settings import EstimatorSettings, MountSettings
from tests.estimation.support import (
    SHORT,
    SHORT_SUPPORT,
    Run,
    Told,
    merged,
    rest_samples,
    run_of,
    told,
)

S = 10**9
FAULT_S = 14.0  # in mid-push of the short run
Readings = list[Displacement]


def short(seed: int) -> Run:
    return run_of(seed, script=SHORT)


def pipeline(start: Start | None = None) -> Pipeline:
    return Pipeline(support=SHORT_SUPPORT, start=start or Start(0.0))


@cache
def fused(seed: int) -> Told:
    return told(pipeline(), short(seed).records())


@cache
def inertial(seed: int) -> Told:
    return told(pipeline(), short(seed).records(()))


def with_readings(seed: int, change: Callable[[Readings], Readings], until_s: float = math.inf) -> Told:
    run = short(seed)
    records = run.records(change(list(run.readings)))
    return told(pipeline(), [r for r in records if r.t_ns < until_s * S])


def after_fault(readings: Readings, change: Callable[[Displacement], Displacement]) -> Readings:
    return [r if r.t_ns < FAULT_S * S else change(r) for r in readings]


@cache
def falling_silent() -> Told:
    return with_readings(2, lambda all_: [r for r in all_ if r.t_ns < FAULT_S * S])


def errors(run: Run, estimates: list[Estimate]) -> NDArray[np.float64]:
    t_ns = np.array([e.t_ns for e in estimates])
    return np.asarray(np.array([e.displacement_m for e in estimates]) - run.truth_m(t_ns))


def in_sigmas(run: Run, estimates: list[Estimate]) -> NDArray[np.float64]:
    return np.asarray(np.abs(errors(run, estimates)) / np.array([e.sigma_m for e in estimates]))


def between(estimates: list[Estimate], from_s: float, to_s: float) -> list[Estimate]:
    return [e for e in estimates if from_s * S < e.t_ns < to_s * S]


def states(estimates: list[Estimate]) -> set[CanState]:
    return {e.can_state for e in estimates}


def assert_both_moves_are_right(run: Run, result: Told) -> None:
    assert [(m.number, m.kind) for m in result.moves] == [(1, MoveKind.PUSH), (2, MoveKind.RETRACT)]
    for move, truth in zip(result.moves, run.moves, strict=True):
        assert move.onset_ns * 1e-9 == pytest.approx(truth.onset_s, abs=0.06)
        assert move.stop_ns * 1e-9 == pytest.approx(truth.stop_s, abs=0.08)
        assert abs(move.end_m - truth.end_m) < 3 * move.sigma_m
        assert abs(move.end_before_stop_m - truth.end_m) < 3 * move.sigma_before_stop_m
        assert move.velocity_m_s == pytest.approx(truth.speed_m_s, rel=0.05)


# --- one cycle as it should be ---------------------------------------------------------------------------------


@pytest.mark.parametrize("can", [True, False])
def test_a_full_cycle_is_found_and_measured(can: bool) -> None:
    run = run_of(2)
    result = told(Pipeline(start=Start(0.0)), run.records(None if can else ()))
    assert_both_moves_are_right(run, result)
    assert (CanState.OK in states(result.provisional)) is can
    # The stated sigma holds 99.7 % of normal errors; these are correlated, so one excursion weighs much.
    assert (in_sigmas(run, result.settled) < 3).mean() > 0.97
    assert np.abs(errors(run, result.settled)).max() < (0.015 if can else 0.045)


def test_segments_follow_each_other_as_in_the_paper_and_begin_with_rest() -> None:
    sequence: list[Segment] = []
    for estimate in fused(2).settled:
        if not sequence or sequence[-1] is not estimate.segment:
            sequence.append(estimate.segment)
    move = [Segment.VVS, Segment.CVS, Segment.VVS, Segment.ZUPT]
    assert sequence == [Segment.ZUPT, *move, *move]
    assert fused(2).provisional[0].segment is Segment.ZUPT


def test_every_step_has_one_provisional_and_one_settled_estimate_and_time_never_goes_back() -> None:
    for result in (fused(2), inertial(2)):
        provisional = [e.t_ns for e in result.provisional]
        assert all(a < b for a, b in pairwise(provisional))
        assert [e.t_ns for e in result.settled] == provisional
        assert len(provisional) == len(short(2).t_ns) // 8


def test_a_settled_estimate_comes_four_seconds_behind() -> None:
    now_ns = 0
    lags = []
    for output in fused(2).outputs:
        if isinstance(output, Estimate):
            if output.tier is Tier.PROVISIONAL:
                now_ns = output.t_ns
            else:
                lags.append((now_ns - output.t_ns) * 1e-9)
    finished_s = 4.0 * 819.2 / 8 * 1.05  # what `finish` settles is younger
    assert np.min(lags[: -int(finished_s)]) == pytest.approx(4.0, abs=0.02)
    assert np.max(lags) == pytest.approx(4.0, abs=0.02)


def test_statistics_come_with_every_estimate() -> None:
    estimates = fused(2).provisional
    assert all(math.isfinite(e.sigma_m) and e.sigma_m > 0 for e in estimates)
    assert all(e.chart_lower_m_s2 < e.chart_upper_m_s2 for e in estimates)
    with_reading = [e for e in estimates if not math.isnan(e.innovation_m)]
    assert len(with_reading) == pytest.approx(len(short(2).readings), abs=3)
    assert all(e.gate_m > 0 for e in with_reading)
    assert max(e.step_m_s for e in estimates) == pytest.approx(0.035, abs=0.006)  # the stop of the retract
    assert {e.move for e in estimates} == {0, 1, 2}
    outside = [
        not e.chart_lower_m_s2 < e.acceleration_m_s2 < e.chart_upper_m_s2
        for e in estimates
        if e.segment is Segment.ZUPT and 3 * S < e.t_ns < 9 * S
    ]
    assert np.mean(outside) < 0.05


@pytest.mark.parametrize("can", [True, False])
def test_stated_sigma_covers_the_error_of_six_machines(can: bool) -> None:
    scores = []
    for seed in range(2, 8):
        run, result = short(seed), (fused if can else inertial)(seed)
        assert_both_moves_are_right(run, result)
        scores.append(in_sigmas(run, result.settled[-1:])[0])
    # Six values of a normal distribution: their root mean square lies below 1.8 with 99.5 %.
    assert np.sqrt(np.mean(np.square(scores))) < 1.8


def test_inertial_sigma_grows_with_every_move_and_fused_does_not() -> None:
    grown = [m.sigma_m for m in inertial(2).moves]
    assert grown[1] > grown[0] > 0.002
    assert max(m.sigma_m for m in fused(2).moves) < 0.001


# --- the same records, however they come -----------------------------------------------------------------------


@pytest.mark.parametrize("at", [0.0, 0.3, 0.81])
def test_a_restored_pipeline_goes_on_with_exactly_the_same_outputs(at: float) -> None:
    records = short(3).records()[: int(0.9 * len(short(3).samples))]
    cut = int(at * len(records)) + 3  # within a step
    first = pipeline()
    for record in records[:cut]:
        first.feed(record)
    second = Pipeline(support=SHORT_SUPPORT)
    second.restore(first.snapshot())
    after = min(cut + 6000, len(records))
    for record in records[cut:after]:
        assert repr(second.feed(record)) == repr(first.feed(record))
    assert second.snapshot() == first.snapshot()
    assert repr(second.finish()) == repr(first.finish())


def test_two_runs_of_the_same_records_are_equal() -> None:
    part = [r for r in short(2).records() if r.t_ns < 13 * S]
    assert repr(told(pipeline(), part).outputs) == repr(told(pipeline(), part).outputs)


def test_foreign_bytes_are_refused_as_a_snapshot() -> None:
    with pytest.raises(ValueError, match="PipelineState"):
        Pipeline().restore(b'{"settled": 3}')


def test_any_mount_gives_the_same_estimates() -> None:
    # The sensor turned half way round the vertical: its -y looks along the push, its -x across.
    def turned(v: Vector) -> Vector:
        return (-v[0], -v[1], v[2])

    part = [s for s in short(2).samples if s.t_ns < 12 * S]
    other = [replace(s, gyro=turned(s.gyro), accel=turned(s.accel)) for s in part]
    expected = told(pipeline(), part)
    result = told(Pipeline(MountSettings(push="-y", up="+z"), SHORT_SUPPORT, start=Start(0.0)), other)
    assert repr(result.outputs) == repr(expected.outputs)


def test_a_reference_reading_changes_nothing() -> None:
    reference = [Displacement(i * S // 10, 0.05, is_reference=True) for i in range(100)]
    part = [s for s in short(2).samples if s.t_ns < 8 * S]
    assert repr(told(pipeline(), merged(part, reference))) == repr(told(pipeline(), part))


def test_samples_from_the_past_are_dropped() -> None:
    part: list[Record] = [s for s in short(2).samples if s.t_ns < 5 * S]
    repeated = [*part[:2000], *part[1000:1100], *part[2000:]]
    assert repr(told(pipeline(), repeated)) == repr(told(pipeline(), part))


# --- the displacement sensor falls ill --------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [2, 3])
def test_a_stuck_sensor_is_recognised_and_not_followed(seed: int) -> None:
    frozen = next(r.value_m for r in short(seed).readings if r.t_ns > FAULT_S * S)
    result = with_readings(seed, lambda all_: after_fault(all_, lambda r: replace(r, value_m=frozen)))
    run = short(seed)
    assert states(between(result.provisional, 13, FAULT_S)) == {CanState.OK}
    assert states(between(result.provisional, FAULT_S + 1.5, 40)) == {CanState.STUCK}
    assert result.moves[0].can_state is CanState.STUCK
    assert in_sigmas(run, result.settled).max() < 3.5
    assert in_sigmas(run, result.settled[-1:])[0] < 3
    # The readings before it was recognised were taken back: no pull towards the frozen value is left.
    assert result.settled[-1].sigma_m > fused(seed).settled[-1].sigma_m


@pytest.mark.parametrize("seed", range(6))
def test_a_sensor_that_freezes_in_a_pause_of_its_own_ends_no_move(seed: int) -> None:
    run = short(seed)
    before = [reading for reading in run.readings if reading.t_ns < 12.9e9]
    after = [
        replace(reading, value_m=before[-1].value_m) if reading.t_ns < 16e9 else reading
        for reading in run.readings
        if reading.t_ns > 13.85e9
    ]
    result = told(pipeline(), run.records([*before, *after]))
    assert "the displacement sensor stands" not in result.words()
    assert CanState.STUCK in states(between(result.settled, 14.5, 16.0))
    assert_both_moves_are_right(run, result)


def test_a_silent_sensor_is_recognised_and_sigma_grows() -> None:
    result, run = falling_silent(), short(2)
    last_s = max(r.t_ns for r in run.readings if r.t_ns < FAULT_S * S) / S
    assert states(between(result.provisional, last_s + 0.35, last_s + 0.99)) == {CanState.LATE}
    assert states(between(result.provisional, last_s + 1.01, 40)) == {CanState.SILENT}
    sigmas = [e.sigma_m for e in between(result.provisional, FAULT_S + 0.5, 18.0)]
    assert all(a < b for a, b in pairwise(sigmas))
    assert result.settled[-1].sigma_m > 2 * fused(2).settled[-1].sigma_m
    assert_both_moves_are_right(run, result)


@pytest.mark.parametrize("seed", [2, 4])
def test_a_jump_of_the_sensor_does_not_pull_the_estimate(seed: int) -> None:
    result = with_readings(seed, lambda all_: after_fault(all_, lambda r: replace(r, value_m=r.value_m + 0.04)), 25)
    run = short(seed)
    assert CanState.BIASED in states(between(result.provisional, FAULT_S, FAULT_S + 2))
    assert result.moves[0].can_state in (CanState.BIASED, CanState.OUT_OF_RANGE)
    assert in_sigmas(run, result.settled).max() < 3.5
    assert np.abs(errors(run, result.settled)).max() < 0.015


@pytest.mark.parametrize(
    ("change", "state"),
    [
        (lambda r: replace(r, fault=ReadingFault.INVALID), CanState.INVALID),
        (lambda r: replace(r, value_m=math.nan), CanState.INVALID),
        (lambda r: replace(r, value_m=0.65), CanState.OUT_OF_RANGE),
    ],
)
def test_a_sensor_that_talks_nonsense_is_not_listened_to(
    change: Callable[[Displacement], Displacement], state: CanState
) -> None:
    result = with_readings(2, lambda all_: after_fault(all_, change), 20)
    assert states(between(result.provisional, FAULT_S + 1, 20)) <= {state, CanState.LATE}
    silent = falling_silent().provisional[: len(result.provisional)]
    assert [e.displacement_m for e in result.provisional] == [e.displacement_m for e in silent]


@pytest.mark.parametrize("start", [Start(0.0), Start()])
def test_a_noiseless_fast_sensor_is_a_good_one(start: Start) -> None:
    run = short(2)
    t_s = np.arange(0.05, run.true_t_s[-1], 0.02)  # 50 Hz, whole millimetres
    exact = [
        Displacement(round(t * S) + 17_500_000, round(value, 3))
        for t, value in zip(t_s.tolist(), run.truth_m(np.rint(t_s * S).astype(np.int64)).tolist(), strict=True)
    ]
    result = told(pipeline(start), run.records(exact))
    assert states(between(result.provisional, 1, 40)) == {CanState.OK}
    assert np.abs(errors(run, between(result.settled, 1, 40))).max() < 0.004


# --- the displacement sensor knows better -----------------------------------------------------------------------


def ramp(until_s: float, seed: int, push_s: float = 10.0) -> tuple[list[Displacement], Run]:
    """A ram that leaves without a burst: 14.5 mm/s from 0 to 200 mm."""
    t_s = np.arange(0.0, until_s, 0.07)
    true_m = np.clip((t_s - push_s) * 0.0145, 0.0, 0.2)
    noise = np.random.default_rng(seed).normal(0.0, 0.003, t_s.size)
    values = np.round(true_m + noise, 3).tolist()
    readings = [Displacement(round(t * S) + 17_500_000, v) for t, v in zip(t_s.tolist(), values, strict=True)]
    empty = np.zeros((0, 3))
    return readings, Run(np.zeros(0, dtype=np.int64), empty, empty, (), t_s, true_m, ())


def test_a_move_that_was_not_felt_is_followed_by_the_displacement_sensor() -> None:
    readings, run = ramp(32.0, 1)
    result = told(Pipeline(start=Start(0.0)), merged(rest_samples(32.0, 3), readings))
    assert "start confirmed (push)" in result.words()  # by the displacement sensor
    assert "no stop was felt, but the displacement sensor stands: move ended" in result.words()
    # At the beginning a move of 2 s has to be told from noise: 29 mm at most.
    assert np.abs(errors(run, result.provisional)).max() < 0.03
    assert np.abs(errors(run, result.settled)).max() < 0.015
    assert np.abs(errors(run, result.settled)[-1]) < 3 * result.settled[-1].sigma_m
    assert result.provisional[-1].segment is Segment.ZUPT
    assert [move.kind for move in result.moves] == [MoveKind.PUSH]
    assert result.moves[0].end_m == pytest.approx(0.2, abs=3 * result.moves[0].sigma_m)


def test_without_any_inertial_sample_the_displacement_sensor_leads() -> None:
    readings, run = ramp(30.0, 2)
    ticks = [Tick(i * S // 4 + 1) for i in range(120)]
    result = told(Pipeline(start=Start(0.0)), merged(readings, ticks))
    assert [event.what.split(":")[0] for event in result.events] == ["the inertial sensor is silent"]
    assert np.abs(errors(run, result.provisional)).max() < 0.015
    assert in_sigmas(run, result.provisional).max() < 4


def test_time_alone_makes_everything_uncertain() -> None:
    result = told(pipeline(), [Tick(i * S) for i in range(60)])
    sigmas = [e.sigma_m for e in result.provisional]
    assert sigmas == sorted(sigmas)
    assert result.provisional[-1].sigma_m >= 0.12 / math.sqrt(12)
    assert states(result.provisional) == {CanState.ABSENT}


def with_false_stop(run: Run) -> Run:
    """A burst like that of a stop in mid-push, but the ram goes on."""
    t_s = run.t_ns * 1e-9
    accel = run.accel.copy()
    accel[(t_s > 13.0) & (t_s < 13.2), 1] -= run.moves[0].speed_m_s / 0.2
    return replace(run, accel=accel)


@pytest.mark.parametrize("seed", [4, 5])
def test_a_false_stop_is_not_believed_while_the_displacement_sensor_goes_on(seed: int) -> None:
    run = with_false_stop(short(seed))
    result = told(pipeline(), run.records())
    assert "stop discarded (push)" in result.words()
    assert_both_moves_are_right(run, result)
    assert in_sigmas(run, result.settled).max() < 3.5


@pytest.mark.parametrize("seed", [4, 5])
def test_a_false_stop_is_taken_back_when_the_displacement_sensor_comes_back_and_goes_on(seed: int) -> None:
    run = with_false_stop(short(seed))
    heard = [reading for reading in run.readings if not 12.9e9 < reading.t_ns < 14.4e9]
    result = told(pipeline(), run.records(heard))
    assert "the displacement sensor still moves: the stop was none, move re-opened" in result.words()
    first, again = [o for o in result.outputs if isinstance(o, Move) and o.number == 1]
    assert first.stop_ns * 1e-9 == pytest.approx(13.05, abs=0.1)
    assert again.stop_ns * 1e-9 == pytest.approx(run.moves[0].stop_s, abs=0.08)
    assert_both_moves_are_right(run, result)
    assert in_sigmas(run, result.settled).max() < 3.5


def test_a_false_stop_is_taken_back_when_the_true_one_is_felt() -> None:
    run = with_false_stop(short(4))
    result = told(pipeline(), run.records(()))
    assert "stop of a move whose start was missed" in result.words()
    first, again = [o for o in result.outputs if isinstance(o, Move) and o.number == 1]
    assert first.end_m < 0.06
    assert again.start_m == first.start_m
    assert again.onset_ns == first.onset_ns
    assert again.stop_ns * 1e-9 == pytest.approx(run.moves[0].stop_s, abs=0.08)
    assert abs(again.end_before_stop_m - run.moves[0].end_m) < 3 * again.sigma_before_stop_m
    assert [move.kind for move in result.moves] == [MoveKind.PUSH, MoveKind.RETRACT]
    assert in_sigmas(run, result.settled[-1:])[0] < 3


def test_a_stop_that_was_not_felt_is_learned_from_the_sensor() -> None:
    # The burst of the stop is taken out of the record: noise of rest about a straight line is put in its place.
    run = short(4)
    stop_s = run.moves[0].stop_s
    t_s = run.t_ns * 1e-9
    burst = np.flatnonzero((t_s > stop_s - 0.3) & (t_s < stop_s + 1.5))
    calm = np.arange(len(burst)) + 4000
    patched = replace(run, gyro=run.gyro.copy(), accel=run.accel.copy())
    for values in (patched.gyro, patched.accel):
        ends = values[burst[0] - 400 : burst[0]].mean(axis=0), values[burst[-1] : burst[-1] + 400].mean(axis=0)
        line = np.linspace(*ends, len(burst))
        values[burst] = line + values[calm] - values[calm].mean(axis=0)
    records = [r for r in patched.records() if r.t_ns < (stop_s + 8) * S]
    result = told(pipeline(), records)
    assert "no stop was felt, but the displacement sensor stands: move ended" in result.words()
    assert len(result.moves) == 1
    assert result.moves[0].stop_ns * 1e-9 == pytest.approx(stop_s, abs=0.6)
    assert abs(errors(run, result.provisional)[-1]) < max(3 * result.provisional[-1].sigma_m, 0.003)


# --- the inertial sensor falls ill ------------------------------------------------------------------------------


def without(samples: Sequence[ImuSample], from_s: float, to_s: float) -> list[ImuSample]:
    return [s for s in samples if not from_s * S < s.t_ns < to_s * S]


@pytest.mark.parametrize("can", [True, False])
def test_a_gap_at_rest_is_told_and_doubted_and_the_run_goes_on(can: bool) -> None:
    run = short(2)
    records = merged(without(run.samples, 5, 6), run.readings if can else ())
    result = told(pipeline(), records)
    assert "gap of 1.00" in result.words()
    assert "the inertial sensor is silent" in result.words()
    before, after = between(result.provisional, 4.5, 5)[-1], between(result.provisional, 6, 6.5)[0]
    assert after.sigma_m > before.sigma_m
    assert [m.kind for m in result.moves] == [MoveKind.PUSH, MoveKind.RETRACT]
    assert in_sigmas(run, result.settled).max() < 3.5


@pytest.mark.parametrize(("seed", "can"), [(2, True), (2, False), (3, False)])
def test_a_gap_in_mid_push_is_told_and_sigma_covers_what_was_missed(seed: int, can: bool) -> None:
    run = short(seed)
    result = told(pipeline(), merged(without(run.samples, 13, 14), run.readings if can else ()))
    assert "gap of 1.00" in result.words()
    assert in_sigmas(run, result.settled).max() < 3.5
    before, after = between(result.provisional, 12, 13)[-1], between(result.provisional, 14, 14.5)[0]
    assert after.sigma_m > before.sigma_m
    assert result.settled[-1].segment is Segment.ZUPT
    if can:
        assert abs(errors(run, result.settled)[-1]) < 0.003
    else:
        assert result.settled[-1].sigma_m >= 0.12 / math.sqrt(12)


def test_a_gap_of_a_tenth_of_a_second_costs_next_to_nothing() -> None:
    run = short(2)
    result = told(pipeline(), without(run.samples, 13, 13.1))
    assert "gap of 0.10" in result.words()
    assert_both_moves_are_right(run, result)
    assert (in_sigmas(run, result.provisional) < 3).all()


def shaken(run: Run, from_s: float, to_s: float) -> Sequence[ImuSample]:
    rng = np.random.default_rng(5)
    hidden = run.accel + rng.normal(0.0, 4.0, run.accel.shape)
    shaking = (run.t_ns > from_s * S) & (run.t_ns < to_s * S)
    return replace(run, accel=np.where(shaking[:, None], hidden, run.accel)).samples


@pytest.mark.parametrize("can", [True, False])
def test_violent_shaking_is_unexplained_and_never_taken_for_a_move(can: bool) -> None:
    run = short(2)
    result = told(pipeline(), merged(shaken(run, 4, 9), run.readings if can else ()))
    assert "motion that is neither a push nor a retract" in result.words()
    assert "at rest again after an unexplained motion" in result.words()
    assert [m.kind for m in result.moves] == [MoveKind.PUSH, MoveKind.RETRACT]
    assert in_sigmas(run, result.settled).max() < 3.5
    assert {e.segment for e in between(result.settled, 5, 9)} == {Segment.VVS}
    assert between(result.settled, 9.5, 9.9)[-1].segment is Segment.ZUPT
    if can:
        assert abs(errors(run, result.settled)[-1]) < 0.003
    else:
        assert result.settled[-1].sigma_m > 0.03


# --- where a stroke starts --------------------------------------------------------------------------------------


def test_an_undetermined_start_is_said_to_be_so_until_the_sensor_speaks() -> None:
    run = short(2)
    late = [r for r in run.readings if r.t_ns > 3 * S]
    result = told(pipeline(Start()), run.records(late))
    unknown = between(result.provisional, 0, 3)
    assert [e.sigma_m for e in unknown] == pytest.approx([0.12 / math.sqrt(12)] * len(unknown), rel=1e-3)
    assert {e.displacement_m for e in unknown} == {0.06}
    assert between(result.provisional, 5, 6)[0].sigma_m < 0.005
    assert in_sigmas(run, result.settled).max() < 3.5
    assert_both_moves_are_right(run, result)


def test_an_undetermined_start_stays_so_without_a_sensor() -> None:
    result = told(pipeline(Start()), [s for s in short(2).samples if s.t_ns < 22 * S])
    assert min(e.sigma_m for e in result.settled) >= 0.12 / math.sqrt(12) * 0.999
    assert [m.kind for m in result.moves] == [MoveKind.PUSH]


def test_a_saved_stroke_is_believed_only_if_no_sensor_speaks() -> None:
    saved = Start(0.07, sigma_m=0.002, only_without_sensor=True)
    run = short(2)
    part = [s for s in run.samples if s.t_ns < 5 * S]
    alone = told(pipeline(saved), part)
    assert "no displacement reading: the saved stroke is believed" in alone.words()
    assert {e.displacement_m for e in between(alone.provisional, 0, 1.99)} == {0.06}
    assert alone.provisional[-1].displacement_m == pytest.approx(0.07)
    assert alone.provisional[-1].sigma_m == pytest.approx(0.002, rel=0.01)
    spoken = told(pipeline(saved), merged(part, [r for r in run.readings if r.t_ns < 5 * S]))
    assert "saved" not in spoken.words()
    assert abs(spoken.provisional[-1].displacement_m) < 0.006


def test_an_unknown_saved_stroke_stays_unknown() -> None:
    part = [s for s in short(2).samples if s.t_ns < 3 * S]
    result = told(pipeline(Start(None, only_without_sensor=True)), part)
    assert result.events == []
    assert result.provisional[-1].sigma_m == pytest.approx(0.12 / math.sqrt(12), rel=1e-3)


# --- the mechanical stop ----------------------------------------------------------------------------------------


def test_the_stop_constraint_can_be_left_out() -> None:
    settings = EstimatorSettings(stop_constraint=False)
    records = [r for r in short(2).records() if r.t_ns < 25 * S]
    result = told(Pipeline(support=SHORT_SUPPORT, estimator=settings, start=Start(0.0)), records)
    assert [m.end_m == m.end_before_stop_m for m in result.moves] == [True]
    assert all(m.end_m != m.end_before_stop_m for m in fused(2).moves)
    assert result.moves[0].sigma_m > fused(2).moves[0].sigma_m


def test_nothing_is_told_before_the_first_step() -> None:
    outputs: list[Output] = []
    fresh = pipeline()
    for sample in short(2).samples[:7]:
        outputs += fresh.feed(sample)
    assert outputs == []
    assert fresh.finish() == []


# --- where the sensor sits --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("imu_on", "kind"), [("link", MoveKind.PUSH), ("base", MoveKind.RETRACT)])
def test_a_move_that_the_sensor_cannot_feel_is_followed_and_does_not_make_the_other_one_ill(
    imu_on: Literal["link", "base"], kind: MoveKind
) -> None:
    # The burst of the move that is not felt is taken out by putting the rest before it in its place.
    run = short(2)
    unfelt = run.moves[1 if kind is MoveKind.PUSH else 0]
    t_s = run.t_ns * 1e-9
    moving = np.flatnonzero((t_s > unfelt.onset_s - 0.2) & (t_s < unfelt.stop_s + 1.5))
    gyro, accel = run.gyro.copy(), run.accel.copy()
    calm = np.arange(4000, 7000)
    for values in (gyro, accel):
        level = values[moving[0] - 400 : moving[0]].mean(axis=0)
        after = values[moving[-1] + 1 :]
        after += level - after[:400].mean(axis=0)  # nor does it tilt
        values[moving] = level + np.resize(values[calm] - values[calm].mean(axis=0), (len(moving), 3))
    felt = replace(run, gyro=gyro, accel=accel)
    result = told(Pipeline(MountSettings(imu_on=imu_on), SHORT_SUPPORT, start=Start(0.0)), felt.records())
    assert [m.kind for m in result.moves] == [kind]
    assert "following it" in result.words()
    assert not states(between(result.provisional, 1, 40)) & {CanState.BIASED, CanState.STUCK}
    assert abs(errors(run, result.settled)[-1]) < max(3 * result.settled[-1].sigma_m, 0.003)


def test_a_wrong_mount_is_noticed_from_gravity() -> None:
    part = [s for s in short(2).samples if s.t_ns < 5 * S]
    result = told(Pipeline(MountSettings(push="+y", up="+x"), SHORT_SUPPORT, start=Start(0.0)), part)
    assert "check [mount] push and up" in result.words()
    tilt = re.search(r"tilted by (\d+) degrees", result.words())
    assert tilt is not None
    assert int(tilt[1]) == pytest.approx(90, abs=6)  # mounting errors of 3 degrees an axis
    assert "mount" not in fused(2).words()
