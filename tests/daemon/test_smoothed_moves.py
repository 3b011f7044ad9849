"""Which smoothed steps belong to a move."""

from __future__ import annotations

from daemon.offline.reviewing.smoothed_moves import SmoothedMoves
from estimation.records import CanState, Estimate, Move, MoveKind, Segment, Tier
from estimation.smoothing.settled_smoother import SmoothedStep

NAN = float("nan")


def step(t_ns: int, number: int, segment: Segment, settled_m: float, smoothed_m: float) -> SmoothedStep:
    estimate = Estimate(
        t_ns, settled_m, 0.01, 0.0, 0.0, segment, Tier.SETTLED, CanState.OK, number, 0.0, NAN, NAN, 0.0, NAN, NAN
    )
    return SmoothedStep(estimate, smoothed_m, 0.001, 0.0, 0.0, 0.0145, 0.0001)


def move(stop_ns: int) -> Move:
    return Move(1, MoveKind.PUSH, stop_ns - 5, stop_ns, 0.0, 0.1, 0.01, 0.1, 0.01, 0.0145, CanState.OK, Tier.SETTLED)


def collected(*steps: SmoothedStep) -> SmoothedMoves:
    moves = SmoothedMoves()
    for one in steps:
        moves.add(one)
    return moves


def test_a_move_goes_from_its_first_step_to_the_first_at_rest() -> None:
    moves = collected(
        step(10, 0, Segment.ZUPT, 0.0, 0.9),
        step(20, 1, Segment.VVS, 0.010, 0.011),
        step(30, 1, Segment.CVS, 0.020, 0.017),
        step(40, 1, Segment.VVS, 0.030, 0.032),
        step(50, 1, Segment.ZUPT, 0.030, 0.031),
        step(60, 1, Segment.ZUPT, 0.030, 0.9),
        step(70, 2, Segment.VVS, 0.040, 0.040),
        step(80, 2, Segment.ZUPT, 0.050, 0.050),
    )
    first = moves.of(move(37))
    assert first is not None
    assert (first.first.settled.t_ns, first.last.settled.t_ns) == (20, 50)
    assert first.largest_difference_m == 0.017 - 0.020
    second = moves.of(move(75))
    assert second is not None
    assert second.last.displacement_m == 0.050
    assert moves.of(move(65)) is None


def test_a_move_that_began_before_the_recording_is_not_taken_for_a_whole_one() -> None:
    moves = collected(step(10, 3, Segment.CVS, 0.2, 0.2), step(20, 3, Segment.ZUPT, 0.3, 0.3))
    assert moves.of(move(15)) is None
