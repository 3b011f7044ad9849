"""The settled track of a virtual support, smoothed: closer to the truth than settled, honest, and nothing disturbed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.virtual.motion import PlannedMove
from estimation.pipeline import Pipeline, Start
from estimation.records import MoveKind
from estimation.settings import EstimatorSettings, SupportSettings
from estimation.smoothing.settled_smoother import SettledSmoother, SmoothedStep
from tests.estimation.support import SHORT, SHORT_SUPPORT, Run, Told, run_of, told

Floats = NDArray[np.float64]
SEEDS = range(1, 9)
# A push that a valve ends, nothing known of the displacement sensor's scale; then one to the stop, which tells it.
CALIBRATED_LATER = (PlannedMove(8.0, 0.3, 0.01453, hard_stop=False), PlannedMove(5.0, 0.5, 0.01453))


@dataclass(frozen=True)
class Smooth:
    """A run, what the pipeline told of it, and the smoothed steps."""

    run: Run
    told: Told
    steps: list[SmoothedStep]

    def errors_mm(self, move: int) -> tuple[Floats, Floats, Floats]:
        """Within a move: settled error, smoothed error, and the smoothed one's stated sigma."""
        found = self.told.moves[move]
        during = [step for step in self.steps if found.onset_ns <= step.settled.t_ns <= found.stop_ns]
        truth = self.run.truth_m(np.array([step.settled.t_ns for step in during]))
        settled = np.array([step.settled.displacement_m for step in during]) - truth
        smoothed = np.array([step.displacement_m for step in during]) - truth
        return settled * 1e3, smoothed * 1e3, np.array([step.sigma_m for step in during]) * 1e3


def smooth(
    seed: int, script: tuple[PlannedMove, ...] = SHORT, *, stop_constraint: bool = True, steps_ahead: int = 10**6
) -> Smooth:
    run = run_of(seed, script=script)
    support = SupportSettings(stroke_mm=1e3 * max(move.target_m for move in script))
    pipeline = Pipeline(support=support, estimator=EstimatorSettings(stop_constraint=stop_constraint), start=Start(0.0))
    steps: list[SmoothedStep] = []
    smoother = SettledSmoother(pipeline, steps.append, steps_ahead)
    said = told(pipeline, run.records())
    smoother.finish()
    return Smooth(run, said, steps)


@pytest.fixture(scope="module")
def smooths() -> list[Smooth]:
    return [smooth(seed) for seed in SEEDS]


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_a_push_that_ends_at_the_stop_is_known_far_better_afterwards(smooths: list[Smooth]) -> None:
    errors = [one.errors_mm(0) for one in smooths]
    settled, smoothed = (rms(np.concatenate([error[i] for error in errors])) for i in (0, 1))
    assert all(one.told.moves[0].kind is MoveKind.PUSH for one in smooths)
    assert smoothed < 0.6 * settled
    assert smoothed < 1.0


def test_the_speed_within_the_push_is_known_better_too(smooths: list[Smooth]) -> None:
    settled, smoothed = [], []
    for one in smooths:
        move = one.told.moves[0]
        # Away from the bursts, where vibration is real motion that no model follows.
        steps = [s for s in one.steps if move.onset_ns + 10**9 < s.settled.t_ns < move.stop_ns - 10**9]
        t_s = np.array([s.settled.t_ns for s in steps]) * 1e-9
        truth = np.gradient(one.run.true_m, one.run.true_t_s)
        true = np.interp(t_s, one.run.true_t_s, truth)
        settled.append(np.array([s.settled.velocity_m_s for s in steps]) - true)
        smoothed.append(np.array([s.velocity_m_s for s in steps]) - true)
    assert rms(np.concatenate(smoothed)) < 0.8 * rms(np.concatenate(settled))


def test_its_stated_sigma_is_honest(smooths: list[Smooth]) -> None:
    """The steps of a move share their error: a move counts once, whatever the number of its steps."""
    nees, inside = [], []
    for one in smooths:
        for move in (0, 1):
            _, error, sigma = one.errors_mm(move)
            nees.append(np.mean((error / sigma) ** 2))
            inside.append(np.mean(np.abs(error) <= 1.96 * sigma))
    # 16 moves, each at worst one draw: 1 +- sqrt(2 / 16) and 0.95 +- sqrt(0.95 * 0.05 / 16), three times that allowed.
    assert 0.2 < np.mean(nees) < 2.06
    assert np.mean(inside) > 0.79


def test_the_last_step_is_the_settled_one_and_every_step_is_there(smooths: list[Smooth]) -> None:
    for one in smooths:
        assert [step.settled for step in one.steps] == one.told.settled
        last = one.steps[-1]
        assert last.displacement_m == last.settled.displacement_m
        assert last.sigma_m == last.settled.sigma_m
        assert last.velocity_m_s == last.settled.velocity_m_s
        assert all(step.sigma_m <= step.settled.sigma_m * (1 + 1e-9) for step in one.steps)


def test_the_speed_of_a_move_is_one_number_in_all_its_steps(smooths: list[Smooth]) -> None:
    for one in smooths:
        move = one.told.moves[0]
        steps = [s for s in one.steps if move.onset_ns <= s.settled.t_ns <= move.stop_ns]
        np.testing.assert_allclose([s.speed_m_s for s in steps], steps[0].speed_m_s, rtol=1e-6)
        np.testing.assert_allclose([s.speed_sigma_m_s for s in steps], steps[0].speed_sigma_m_s, rtol=1e-3)
        # The stop's own word on it, and the true mean.
        assert steps[0].speed_m_s == pytest.approx(move.velocity_m_s, rel=0.01)
        true = (one.run.truth_m(move.stop_ns) - one.run.truth_m(move.onset_ns)) / (
            (move.stop_ns - move.onset_ns) * 1e-9
        )
        assert abs(steps[0].speed_m_s - true) < 4 * steps[0].speed_sigma_m_s


def test_a_stop_reached_later_corrects_the_move_before_it() -> None:
    errors = []
    for seed in SEEDS[:4]:
        one = smooth(seed, CALIBRATED_LATER)
        assert len(one.told.moves) == 2
        errors.append(one.errors_mm(0))
    settled, smoothed = (rms(np.concatenate([error[i] for error in errors])) for i in (0, 1))
    assert smoothed < 0.7 * settled


def test_the_pipeline_tells_the_same_with_and_without_a_smoother(smooths: list[Smooth]) -> None:
    run = run_of(SEEDS[0], script=SHORT)
    plain = told(Pipeline(support=SHORT_SUPPORT, start=Start(0.0)), run.records())
    # As text: NaN equals NaN, and every bit shows.
    assert repr(plain.outputs) == repr(smooths[0].told.outputs)


def test_a_bounded_memory_changes_little_once_a_move_and_its_stop_fit_into_it(smooths: list[Smooth]) -> None:
    whole = smooths[0]
    move = whole.told.moves[0]
    duration = sum(move.onset_ns - 10**8 <= s.settled.t_ns <= move.stop_ns + 10**9 for s in whole.steps)
    bounded = smooth(SEEDS[0], steps_ahead=duration)
    assert len(bounded.steps) > 2 * duration
    assert [s.settled.t_ns for s in bounded.steps] == [s.settled.t_ns for s in whole.steps]
    for one, other in zip(bounded.steps, whole.steps, strict=True):
        # What later data bring on top moves the estimate by as much as they shrink its variance.
        learned = one.sigma_m**2 - other.sigma_m**2
        assert learned >= -1e-12
        assert (one.displacement_m - other.displacement_m) ** 2 <= 16 * learned + 1e-12
        assert learned < 0.5 * other.sigma_m**2
    # The last steps are conditioned on all that follows in any case.
    assert repr(bounded.steps[-duration:]) == repr(whole.steps[-duration:])


def test_without_the_stop_constraint_there_is_less_to_learn_from(smooths: list[Smooth]) -> None:
    free = smooth(SEEDS[0], stop_constraint=False)
    _, _, sigma = free.errors_mm(0)
    _, _, constrained = smooths[0].errors_mm(0)
    assert sigma[-1] > 1.5 * constrained[-1]
