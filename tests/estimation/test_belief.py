from __future__ import annotations

from dataclasses import replace

import pytest

from estimation.belief import SEGMENT_OF, Belief, Free, Phase
from estimation.recognition.motion import Decision, Motion
from estimation.records import Segment

S = 10**9
PUSH = Motion(1, 10 * S, confirmed=True)
ENDED = Motion(1, 10 * S, confirmed=True, stop_ns=20 * S, stop_confirmed=True)


@pytest.mark.parametrize(
    ("t_s", "phase"),
    [
        (9.89, Phase.REST),
        (9.95, Phase.START),  # the refined onset may be a little late
        (10.89, Phase.START),
        (10.91, Phase.CRUISE),
        (19.89, Phase.CRUISE),
        (19.91, Phase.STOP),
        (20.79, Phase.STOP),
        (20.81, Phase.REST),
        (30.0, Phase.FREE),
        (31.99, Phase.FREE),
        (32.0, Phase.REST),
        (40.5, Phase.START),
        (41.5, Phase.START),  # a slow start takes longer
        (41.7, Phase.CRUISE),
        (99.0, Phase.CRUISE),  # not stopped yet
    ],
)
def test_phase_follows_from_the_belief(t_s: float, phase: Phase) -> None:
    first = Motion(1, 10 * S, confirmed=True, stop_ns=20 * S, stop_confirmed=True)
    second = Motion(-1, 40 * S, slow=True)
    found, motion = Belief([first, Free(30 * S, 32 * S), second]).phase_at(round(t_s * S))
    assert found is phase
    assert motion is (None if phase in (Phase.REST, Phase.FREE) else first if t_s < 25 else second)


def test_open_end_of_a_free_motion_lasts() -> None:
    assert Belief([Free(5)]).phase_at(10**15) == (Phase.FREE, None)
    assert Belief([Free(5)]).phase_at(4) == (Phase.REST, None)


def test_every_phase_has_its_segment() -> None:
    assert {SEGMENT_OF[phase] for phase in Phase} == set(Segment)
    assert SEGMENT_OF[Phase.REST] is Segment.ZUPT
    assert SEGMENT_OF[Phase.CRUISE] is Segment.CVS


def test_belief_follows_the_decisions_of_the_recogniser() -> None:
    belief = Belief()
    proposed = Motion(1, 10 * S)
    belief.follow(Decision.START_PROPOSED, proposed)
    assert belief.items == [proposed]
    belief.follow(Decision.START_DISCARDED, None)
    assert belief.items == []
    belief.follow(Decision.START_PROPOSED, proposed)
    belief.follow(Decision.START_CONFIRMED, PUSH)
    belief.follow(Decision.STOP_PROPOSED, ENDED)
    belief.follow(Decision.STOP_DISCARDED, PUSH)
    assert belief.items == [PUSH]
    belief.replace_last(ENDED)
    assert belief.last_motion == ENDED
    assert belief.rests_since_ns() == 20 * S + 800_000_000


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ([], [Free(12 * S)]),
        ([ENDED], [ENDED, Free(12 * S)]),
        ([PUSH], [replace(PUSH, cut_ns=12 * S), Free(12 * S)]),  # cut: how it went on is not known
        ([replace(PUSH, stop_ns=11 * S)], [replace(PUSH, cut_ns=12 * S), Free(12 * S)]),
        ([Motion(1, 10 * S)], [Free(12 * S)]),  # an unproven one is forgotten
    ],
)
def test_unexplained_time_ends_a_move_that_went_on(before: list[Motion | Free], after: list[Motion | Free]) -> None:
    belief = Belief(before.copy())
    belief.begin_free(12 * S)
    assert belief.items == after
    assert belief.open_free == after[-1]
    assert belief.last_motion is None
    assert belief.rests_since_ns() is None
    belief.end_free(15 * S)
    assert belief.open_free is None
    assert belief.rests_since_ns() == 15 * S


def test_a_cut_move_lasts_to_the_unexplained_time_and_not_beyond() -> None:
    belief = Belief([PUSH])
    belief.begin_free(12 * S)
    belief.end_free(15 * S)
    phases = [belief.phase_at(t)[0] for t in (9 * S, 10 * S, 11 * S, 12 * S, 14 * S, 15 * S, 90 * S)]
    expected = [Phase.REST, Phase.START, Phase.CRUISE, Phase.FREE, Phase.FREE, Phase.REST, Phase.REST]
    assert phases == expected
    assert isinstance(belief.items[0], Motion)
    assert belief.items[0].cut_ns == 12 * S
    assert belief.items[1] == Free(12 * S, 15 * S)


def test_the_past_is_forgotten_but_for_the_last_two_items() -> None:
    late = Motion(-1, 40 * S, stop_ns=50 * S)
    belief = Belief([ENDED, Free(30 * S, 32 * S), late])
    belief.forget_before(20 * S)
    assert len(belief.items) == 3
    belief.forget_before(31 * S)
    assert belief.items == [Free(30 * S, 32 * S), late]
    belief.forget_before(100 * S)
    assert belief.items == [Free(30 * S, 32 * S), late]  # a start may be proposed yet, and the stop before it be none
    assert Belief().rests_since_ns() is None
