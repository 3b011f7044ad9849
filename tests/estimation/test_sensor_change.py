"""Another inertial sensor in mid-run: what was learned of the last one must not be held against it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimation.pipeline import Pipeline, Start
from estimation.records import ImuSample, Record, SensorChange
from tests.estimation.support import SHORT, SHORT_SUPPORT, Told, merged, run_of, told

S = 1_000_000_000
LAST_S, FIRST_S = 4.0, 4.8  # of the old sensor, of the new one
GYRO_RAD_S, ACCEL_M_S2 = 0.009, 0.3  # a usual difference between two parts, and a large one
SEED = 2


def _of_the_new_sensor(sample: ImuSample) -> ImuSample:
    (a, b, c), (x, y, z) = sample.gyro, sample.accel
    return replace(
        sample,
        gyro=(a + GYRO_RAD_S, b - GYRO_RAD_S, c + GYRO_RAD_S),
        accel=(x - ACCEL_M_S2, y + ACCEL_M_S2, z - ACCEL_M_S2),
    )


@cache
def outcome(*, said: bool) -> Told:
    """A push and a retract by another sensor than the one that knew the first seconds."""
    run = run_of(SEED, script=SHORT)
    samples = [s for s in run.samples if s.t_ns < LAST_S * S]
    samples += [_of_the_new_sensor(s) for s in run.samples if s.t_ns > FIRST_S * S]
    change: list[Record] = [SensorChange(round(FIRST_S * S) - 1)] if said else []
    records = merged(change, samples, run.readings)
    return told(Pipeline(support=SHORT_SUPPORT, start=Start(0.0)), records)


def test_the_change_is_told_and_both_moves_are_measured_as_ever() -> None:
    result, run = outcome(said=True), run_of(SEED, script=SHORT)
    assert "another inertial sensor" in result.words()
    assert len(result.moves) == 2
    for move, true in zip(result.moves, run.moves, strict=True):
        assert move.end_m == pytest.approx(true.end_m, abs=4 * move.sigma_m)
        assert move.onset_ns == pytest.approx(true.onset_s * S, abs=0.15 * S)


def test_its_other_biases_are_no_motion() -> None:
    resting = [e for e in outcome(said=True).provisional if FIRST_S + 1.5 < e.t_ns / S < 9.0]
    assert len(resting) > 200
    assert max(abs(e.velocity_m_s) for e in resting) == 0.0
    assert max(abs(e.acceleration_m_s2) for e in resting) < ACCEL_M_S2 / 2


def test_without_a_word_the_same_samples_look_like_motion() -> None:
    felt = [abs(e.acceleration_m_s2) for e in outcome(said=False).provisional if FIRST_S + 0.1 < e.t_ns / S < 5.5]
    assert max(felt) > ACCEL_M_S2 / 2
    told_of = [abs(e.acceleration_m_s2) for e in outcome(said=True).provisional if FIRST_S + 0.1 < e.t_ns / S < 5.5]
    assert np.median(felt) > 4 * np.median(told_of)


def test_the_change_survives_a_snapshot() -> None:
    run = run_of(SEED, script=SHORT)
    before = [s for s in run.samples if s.t_ns < LAST_S * S]
    after = [_of_the_new_sensor(s) for s in run.samples if FIRST_S * S < s.t_ns < 9.0 * S]
    whole, copy = Pipeline(support=SHORT_SUPPORT), Pipeline(support=SHORT_SUPPORT)
    change: list[Record] = [*before, SensorChange(round(FIRST_S * S) - 1)]
    for record in change:
        whole.feed(record)
    copy.restore(whole.snapshot())
    # As text: NaN does not equal itself.
    assert [repr(whole.feed(record)) for record in after] == [repr(copy.feed(record)) for record in after]


def test_a_change_before_anything_was_heard_is_none() -> None:
    pipeline = Pipeline()
    assert pipeline.feed(SensorChange(5)) == []
    assert pipeline.state.first_ns is None
