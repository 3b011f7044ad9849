"""What outlasts a run: exact as text, refused when impossible, more doubtful with time, of no doubtful move."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from estimation.gaussian import Gaussian
from estimation.learned import (
    DAY_S,
    IMPOSSIBLE_SIGMAS,
    NAMES,
    NOMINAL_TOLERANCE,
    Learned,
    Machine,
    is_positive_definite,
    prior_of,
)
from estimation.mskf import LEARNED
from estimation.pipeline import Pipeline, Start
from estimation.records import Displacement, Move, Output, Record
from estimation.settings import EstimatorSettings, SupportSettings
from tests.estimation.learned_kit import MEAN, PRIOR, SUPPORT, covariance, learned_of
from tests.estimation.support import SHORT, SHORT_SUPPORT, Run, Told, run_of, told

S = 10**9
ESTIMATOR = EstimatorSettings()
SIGMA = [float(s) for s in np.sqrt(np.diag(covariance()))]
SPEEDS = slice(NAMES.index("push_speed"), NAMES.index("retract_speed") + 1)


def matrix(states: Gaussian) -> Any:
    return np.array(states.p)


# --- as text ---------------------------------------------------------------------------------------------------


@settings(derandomize=True, deadline=None, max_examples=50)
@given(
    seed=st.integers(0, 2**32),
    factor=st.floats(1e-6, 1e3),
    means=st.lists(st.floats(-100, 100), min_size=len(NAMES), max_size=len(NAMES)),
    noise_m=st.floats(1e-9, 1),
    strokes=st.integers(1, 10**9),
    signal=st.text(max_size=200),
)
def test_it_survives_as_text_to_the_last_bit(
    seed: int, factor: float, means: list[float], noise_m: float, strokes: int, signal: str
) -> None:
    states = Gaussian(means, (covariance(seed) * factor).tolist())
    learned = Learned.of(Machine.of(SUPPORT, signal), states, strokes, 0, noise_m)
    assert Learned.model_validate_json(learned.model_dump_json()) == learned
    assert Learned.model_validate_json(json.dumps(learned.model_dump())) == learned


def test_rounding_in_the_filter_leaves_a_symmetric_covariance() -> None:
    p = covariance()
    p[0, 1] *= 1 + 1e-15
    learned = Learned.of(Machine.of(SUPPORT), Gaussian(list(MEAN), p.tolist()), 1, 0, 0.003)
    assert (matrix(learned.states) == matrix(learned.states).T).all()


def test_each_value_has_its_name() -> None:
    learned = learned_of()
    assert learned.push == pytest.approx((0.01461, SIGMA[4], 4))
    assert learned.retract == pytest.approx((0.0354, SIGMA[5], 3))
    assert [learned.value(name) for name in NAMES] == [pytest.approx(pair) for pair in zip(MEAN, SIGMA, strict=True)]
    assert learned.calibrations == 7


def tree(**changes: Any) -> dict[str, Any]:
    plain: dict[str, Any] = json.loads(learned_of().model_dump_json())
    return plain | changes


def with_entry(i: int, j: int, value: Any) -> list[list[Any]]:
    p: list[list[Any]] = covariance().tolist()
    p[i][j] = value
    return p


N = len(NAMES)
IMPOSSIBLE: dict[str, dict[str, Any]] = {
    "singular": tree(covariance=[[1e-6] * N] * N),
    "negative": tree(covariance=(-covariance()).tolist()),
    "correlated beyond one": tree(
        covariance=[[SIGMA[i] * SIGMA[j] * (1 + (i != j)) for j in range(N)] for i in range(N)]
    ),
    "asymmetric": tree(covariance=with_entry(0, 1, 1e-7)),
    "known without doubt": tree(covariance=np.diag([0.0] + [1e-6] * (N - 1)).tolist()),
    "known all but without doubt": tree(covariance=np.diag([1e-320] + [1e-6] * (N - 1)).tolist()),
    "nothing": tree(covariance=[]),
    "rows missing": tree(covariance=covariance().tolist()[:-1]),
    "columns missing": tree(covariance=[row[:-1] for row in covariance().tolist()]),
    "text": tree(covariance=with_entry(0, 0, "1e-6")),
    "not a number": tree(covariance=with_entry(2, 2, math.nan)),
    "infinite": tree(mean=[math.inf, *MEAN[1:]]),
    "huge": tree(mean=[1e30, *MEAN[1:]]),
    "means missing": tree(mean=list(MEAN[:-1])),
    "other states": tree(names=[*NAMES[:-1], "colour"]),
    "no noise": tree(noise_m=0.0),
    "no stroke": tree(pushes=0, retracts=0),
    "fewer strokes than none": tree(pushes=-1),
    "half a stroke": tree(pushes=1.5),
    "a yes": tree(pushes=True),
    "more than there is": tree(colour="red"),
    "no machine": tree(machine=None),
    "a machine without stroke": tree(machine=tree()["machine"] | {"stroke_m": 0}),
}


@pytest.mark.parametrize("what", IMPOSSIBLE)
def test_what_cannot_have_been_learned_is_refused(what: str) -> None:
    with pytest.raises(ValidationError):
        Learned.model_validate_json(json.dumps(IMPOSSIBLE[what]))


def test_the_tree_that_the_impossible_ones_are_made_of_is_accepted() -> None:
    assert Learned.model_validate_json(json.dumps(tree())) == learned_of()


def test_a_covariance_that_is_not_positive_definite_is_named_as_such() -> None:
    with pytest.raises(ValueError, match="the covariance is not positive definite"):
        Learned.of(Machine.of(SUPPORT), Gaussian(list(MEAN), [[1e-6] * N] * N), 1, 1, 0.003)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(1, 7),
    scales=st.lists(st.floats(1e-5, 10), min_size=7, max_size=7),
    shift=st.floats(-1.2, 0.5),
)
def test_positive_definite_is_what_the_eigenvalues_say(seed: int, n: int, scales: list[float], shift: float) -> None:
    factors = np.random.default_rng(seed).normal(size=(n, n))
    p = factors @ factors.T / n + shift * np.eye(n)
    scaled = p * np.outer(scales[:n], scales[:n])
    diagonal = np.diag(scaled)
    if (diagonal <= 0).any():
        assert not is_positive_definite(scaled.tolist())
        return
    least = np.linalg.eigvalsh(scaled / np.sqrt(np.outer(diagonal, diagonal))).min()
    if abs(least) > 1e-9:
        assert is_positive_definite(scaled.tolist()) is bool(least > 0)


# --- whose it is -----------------------------------------------------------------------------------------------

HERE = Machine.of(SUPPORT, "SupportStatus.ram_stroke", "serial 7")
ELSEWHERE = {
    "stroke": (SupportSettings(stroke_mm=501), "its stroke is 500 mm, not 501 mm"),
    "push": (
        SupportSettings(nominal_push_speed_mm_s=14.53 / (1 - 1.01 * NOMINAL_TOLERANCE)),
        "its nominal push speed is 14.53 mm/s, not 15.3028 mm/s",
    ),
    "retract": (SupportSettings(nominal_retract_speed_mm_s=30), "its nominal retract speed is 35.19 mm/s, not 30 mm/s"),
}


@pytest.mark.parametrize("what", ELSEWHERE)
def test_another_machine_is_told_by_what_differs(what: str) -> None:
    support, difference = ELSEWHERE[what]
    other = Machine.of(support)
    assert HERE.difference(other) == difference
    with pytest.raises(ValueError, match=re.escape(f"learned on another machine ({difference})")):
        learned_of(HERE).check(other, prior_of(support, ESTIMATOR))
    with pytest.raises(ValueError, match=difference):
        Pipeline(support=support, start=Start(learned=learned_of(HERE)))


def test_another_displacement_signal_is_another_machine_and_another_inertial_part_is_not() -> None:
    assert HERE.difference(Machine.of(SUPPORT, "Position.position")) == (
        "its displacement signal is 'SupportStatus.ram_stroke', not 'Position.position'"
    )
    assert HERE.difference(Machine.of(SUPPORT, "SupportStatus.ram_stroke", "serial 8")) is None
    assert HERE.difference(Machine.of(SUPPORT)) is None  # a signal that nobody names differs from none
    assert HERE.difference(Machine.of(SupportSettings(nominal_push_speed_mm_s=14.53 * 1.04))) is None


def test_names_that_are_not_known_are_taken_over() -> None:
    assert Machine.of(SUPPORT).named_as(HERE) == HERE
    other = Machine.of(SUPPORT, "Position.position", "serial 8")
    assert other.named_as(HERE) == other


@pytest.mark.parametrize("i", range(N))
def test_a_value_beyond_all_belief_is_refused_by_name(i: int) -> None:
    for sign in (-1, 1):
        for sigmas, fits in ((0.9 * IMPOSSIBLE_SIGMAS, True), (1.1 * IMPOSSIBLE_SIGMAS, False)):
            mean = [*MEAN[:i], PRIOR.x[i] + sign * sigmas * PRIOR.sigma(i), *MEAN[i + 1 :]]
            learned = learned_of().model_copy(update={"mean": tuple(mean)})
            if fits:
                learned.check(Machine.of(SUPPORT), PRIOR)
            else:
                with pytest.raises(ValueError, match=f"its {NAMES[i]} of .* cannot have been learned"):
                    learned.check(Machine.of(SUPPORT), PRIOR)


# --- the time between ------------------------------------------------------------------------------------------

SECONDS = st.floats(0, 1e10)


def test_a_day_costs_what_the_constants_promise() -> None:
    """From certainty: 0.3 % of a speed (prior 2 %), 0.07 % of scale (1 %), 0.1 mm of offset (1.5 mm)."""
    certain = Gaussian(PRIOR.x, (1e-12 * matrix(PRIOR)).tolist())
    after = Learned.of(Machine.of(SUPPORT), certain, 1, 1, 0.003).inflated(DAY_S, PRIOR)
    assert after.push.sigma_m_s == pytest.approx(0.003 * 0.01453, rel=0.02)
    assert after.retract.sigma_m_s == pytest.approx(0.003 * 0.03519, rel=0.02)
    assert after.value("scale")[1] == pytest.approx(0.0007, rel=0.1)
    assert after.value("offset")[1] == pytest.approx(0.0001, rel=0.15)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(seed=st.integers(0, 2**32), first_s=SECONDS, second_s=SECONDS)
def test_doubt_only_grows_and_never_beyond_the_prior(seed: int, first_s: float, second_s: float) -> None:
    """In the order of matrices: no combination of the states becomes better known, none worse than the prior."""
    learned = learned_of(seed=seed)
    sooner = learned.inflated(first_s, PRIOR)
    later = sooner.inflated(second_s, PRIOR)
    scale = np.sqrt(np.outer(np.diag(matrix(PRIOR)), np.diag(matrix(PRIOR))))
    for less, more in (
        (learned.states.p, sooner.states.p),
        (sooner.states.p, later.states.p),
        (later.states.p, PRIOR.p),
    ):
        assert np.linalg.eigvalsh((np.array(more) - np.array(less)) / scale).min() > -1e-12
    assert is_positive_definite(later.states.p)
    for i in range(N):
        assert abs(later.mean[i] - PRIOR.x[i]) <= abs(sooner.mean[i] - PRIOR.x[i]) * (1 + 1e-12)
    # Two pauses are one of their sum: an Ornstein-Uhlenbeck process has no memory of how it got there.
    at_once = learned.inflated(first_s + second_s, PRIOR)
    assert later.mean == pytest.approx(at_once.mean, rel=1e-9)
    np.testing.assert_allclose(matrix(later.states) / scale, matrix(at_once.states) / scale, rtol=1e-9, atol=1e-13)


def test_no_time_changes_nothing_and_endless_time_leaves_the_prior() -> None:
    learned = learned_of()
    assert learned.inflated(0.0, PRIOR).states == learned.states
    assert learned.inflated(-5.0, PRIOR).states == learned.states
    forgotten = learned.inflated(math.inf, PRIOR)
    assert forgotten.states == PRIOR
    assert (forgotten.pushes, forgotten.noise_m) == (learned.pushes, learned.noise_m)


@settings(derandomize=True, deadline=None, max_examples=50)
@given(seed=st.integers(0, 2**32), factor=st.floats(1e-2, 1e3), elapsed_s=SECONDS)
def test_settings_that_have_become_more_certain_are_not_exceeded(seed: int, factor: float, elapsed_s: float) -> None:
    wide = Gaussian(list(MEAN), (covariance(seed) * factor).tolist())
    inflated = Learned.of(Machine.of(SUPPORT), wide, 1, 1, 0.003).inflated(elapsed_s, PRIOR)
    assert is_positive_definite(inflated.states.p)
    for i in range(N):
        assert inflated.states.sigma(i) <= PRIOR.sigma(i) * (1 + 1e-12)


# --- in the estimator ------------------------------------------------------------------------------------------


def short_pipeline(learned: Learned | None = None, displacement_m: float | None = None) -> Pipeline:
    return Pipeline(support=SHORT_SUPPORT, start=Start(displacement_m, learned=learned))


def test_an_estimator_begins_with_what_it_is_given_and_gives_it_back() -> None:
    machine = Machine.of(SHORT_SUPPORT)
    learned = learned_of(machine)
    begun = short_pipeline(learned)
    assert begun.learned() == learned
    assert begun.learned(Machine.of(SHORT_SUPPORT, "x", "y")) == learned_of(Machine.of(SHORT_SUPPORT, "x", "y"))
    for track in (begun.state.settled, begun.state.head):
        assert [track.usual_speed(direction) for direction in (1, -1)] == list(MEAN)[SPEEDS]
        assert [track.strokes_learned(direction) for direction in (1, -1)] == [4, 3]
    assert begun.strokes_learned == 7
    again = Pipeline(support=SHORT_SUPPORT)
    again.restore(begun.snapshot())
    assert again.learned() == learned


def test_an_estimator_that_has_seen_nothing_has_learned_nothing() -> None:
    assert Pipeline().learned() is None
    assert Pipeline(start=Start(0.1)).learned() is None


@cache
def two_cycles(seed: int) -> Run:
    return run_of(seed, script=SHORT, cycles=2)


@cache
def watched(seed: int) -> tuple[list[tuple[int, Learned | None]], Told]:
    """What was learned at each change, over two cycles; and all outputs."""
    pipeline = short_pipeline(displacement_m=0.0)
    outputs: list[Output] = []
    seen: list[tuple[int, Learned | None]] = []
    for record in two_cycles(seed).records():
        new = pipeline.feed(record)
        outputs += new
        if new and (not seen or pipeline.strokes_learned != (seen[-1][1].calibrations if seen[-1][1] else 0)):
            seen.append((record.t_ns, pipeline.learned()))
    outputs += pipeline.finish()
    seen.append((record.t_ns, pipeline.learned()))
    return seen, Told(tuple(outputs))


def test_a_stroke_is_learned_once_it_is_settled_not_before() -> None:
    seen, result = watched(1)
    assert [0 if learned is None else learned.calibrations for _, learned in seen] == [0, 1, 2, 3, 4]
    moves = result.moves
    assert [(m.pushes, m.retracts) for _, m in seen[1:] if m] == [(1, 0), (1, 1), (2, 1), (2, 2)]
    for move, (t_ns, _) in zip(moves[:3], seen[1:], strict=False):
        assert 4.0 * S < t_ns - move.stop_ns < 6.0 * S
    # The last one was settled by the end of the data; its stop had been confirmed.
    assert seen[-1][0] - moves[-1].stop_ns < 4.0 * S


def states_of(learned: Learned | None) -> tuple[object, ...] | None:
    """What moves teach; the noise is learned at every reading."""
    return None if learned is None else (learned.mean, learned.covariance, learned.pushes, learned.retracts)


def test_while_a_move_goes_on_nothing_of_it_is_learned() -> None:
    run = two_cycles(1)
    push, _ = run.moves
    pipeline = short_pipeline(learned_of(Machine.of(SHORT_SUPPORT)), 0.0)
    during: set[object] = set()
    for record in run.records():
        pipeline.feed(record)
        if push.onset_s + 4.2 < record.t_ns / S < push.stop_s + 4.0:
            during.add(states_of(pipeline.learned()))
    assert len(during) == 1
    assert states_of(pipeline.learned()) not in during


def test_a_stop_that_is_not_confirmed_when_the_data_end_is_not_learned() -> None:
    run = two_cycles(1)
    push, _ = run.moves
    known = learned_of(Machine.of(SHORT_SUPPORT))
    for late_s, strokes in ((1.15, 0), (2.5, 1)):
        pipeline = short_pipeline(known, 0.0)
        result = told(pipeline, [r for r in run.records() if r.t_ns < (push.stop_s + late_s) * S])
        assert len(result.moves) == strokes
        assert pipeline.strokes_learned == known.calibrations + strokes
        after = pipeline.learned()
        assert after is not None
        # Readings at rest tell the scale no better; those of the push do.
        scale_sigma = after.value("scale")[1] / known.value("scale")[1]
        assert (scale_sigma > 0.999) is (strokes == 0)
        assert (scale_sigma < 0.995) is (strokes == 1)


def test_a_doubtful_move_is_not_learned() -> None:
    """The sensor slips by 12 mm in the second push: too much for its scale, too little to be rejected at once."""
    run = two_cycles(1)
    seen, _ = watched(1)
    after_first_cycle = next(learned for _, learned in seen if learned is not None and learned.calibrations == 2)
    cycle_s = float(run.true_t_s[-1])
    slip_s = cycle_s + 14.0

    def slipped(reading: Displacement) -> Displacement:
        return reading if reading.t_ns < slip_s * S else replace(reading, value_m=reading.value_m - 0.012)

    records = run.records([slipped(r) for r in run.readings])
    pipeline = short_pipeline(displacement_m=0.0)
    before: Learned | None = None
    moves: list[Move] = []
    for record in records:
        moves += [o for o in pipeline.feed(record) if isinstance(o, Move)]
        if record.t_ns < (cycle_s + 11.0) * S:
            before = pipeline.learned()
        if record.t_ns > (cycle_s + run.moves[0].stop_s + 7.0) * S:
            break
    assert [m.number for m in moves] == [1, 2, 3]
    after = pipeline.learned()
    assert before is not None
    assert after is not None
    assert before.calibrations == after.calibrations == after_first_cycle.calibrations == 2
    # At rest on the 12 mm the offset may follow a little, the speeds and the scale keep what they were.
    assert after.push.speed_m_s == pytest.approx(before.push.speed_m_s, abs=0.1 * before.push.sigma_m_s)
    assert after.value("scale")[0] == pytest.approx(before.value("scale")[0], abs=before.value("scale")[1])


def halves(records: Sequence[Record], at_ns: int) -> tuple[list[Record], list[Record]]:
    return [r for r in records if r.t_ns < at_ns], [r for r in records if r.t_ns >= at_ns]


@pytest.mark.parametrize("seed", [1, 3])
def test_after_a_restart_a_cycle_is_measured_as_well_as_without_one(seed: int) -> None:
    run = two_cycles(seed)
    first, second = halves(run.records(), round((run.true_t_s[-1] + 4.5) * S))
    whole = watched(seed)[1].moves[2:]
    before = short_pipeline(displacement_m=0.0)
    told(before, first)
    restarted = told(short_pipeline(before.learned()), second).moves
    afresh = told(short_pipeline(), second).moves
    for one, two, new in zip(whole, restarted, afresh, strict=True):
        assert one.kind == two.kind == new.kind
        assert two.sigma_before_stop_m < 1.1 * one.sigma_before_stop_m
        # Only where the ram stood was forgotten; both know it to a millimetre by the readings since.
        assert abs(two.end_before_stop_m - one.end_before_stop_m) < one.sigma_before_stop_m
        assert two.sigma_before_stop_m < 0.9 * new.sigma_before_stop_m
    assert restarted[0].sigma_before_stop_m < 0.6 * afresh[0].sigma_before_stop_m


def test_every_state_that_outlasts_a_move_has_a_name() -> None:
    assert len(NAMES) == len(set(NAMES)) == len(LEARNED)
