"""A decoder that goes on where another one stopped behaves as if there had been only one."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.displacement import DisplacementDecoder
from drivers.can.frame import Frame
from tests.drivers.can_kit import MS, decoder, emergency, heartbeat, position, status


def support_controller_frame(t_ns: int, number: int) -> Frame:
    return Frame(t_ns, 0x310, status(100 + number % 7, number % 5, valid=number % 11 > 0))


def canopen_frame(t_ns: int, number: int) -> Frame:
    return {
        0: emergency(0x5000, 1, t_ns=t_ns),
        1: emergency(0, 0, t_ns=t_ns),
        2: heartbeat(number % 128, t_ns=t_ns),
    }.get(number, Frame(t_ns, 0x1FF, position(1000 + number)))


SOURCES: dict[str, Callable[[int, int], Frame]] = {
    "support_controller": support_controller_frame,
    "cia406": canopen_frame,
}


@settings(derandomize=True, deadline=None)
@given(
    preset=st.sampled_from(sorted(SOURCES)),
    frames=st.lists(st.tuples(st.integers(0, 1500), st.integers(0, 12)), min_size=2, max_size=60),
    cut=st.integers(0, 60),
)
def test_readings_are_the_same_wherever_the_memory_is_handed_over(
    preset: str, frames: list[tuple[int, int]], cut: int
) -> None:
    t_ns, taken = 0, []
    for gap_ms, number in frames:
        t_ns += gap_ms * MS
        taken.append(SOURCES[preset](t_ns, number))
    whole, first, second = decoder(preset=preset), decoder(preset=preset), decoder(preset=preset)
    expected = [whole.decode(frame) for frame in taken]
    readings = [first.decode(frame) for frame in taken[:cut]]
    second.recall(json.loads(json.dumps(first.remembered())))
    readings += [second.decode(frame) for frame in taken[cut:]]
    assert readings == expected
    assert second.remembered() == whole.remembered()


def remembering() -> DisplacementDecoder:
    """A decoder with something in every field of its memory."""
    reader = decoder(preset="cia406", counter_signal="speed")
    reader.decode(emergency(0x5000, 1, t_ns=1))
    reader.decode(emergency(0x8130, 0x11, t_ns=1))
    reader.decode(heartbeat(5, t_ns=2))
    for number in range(200):
        reader.decode(Frame(number * 20 * MS, 0x1FF, number.to_bytes(4, "little") + bytes([number * 2 % 256, 0])))
    return reader


def places(memory: dict[str, Any]) -> list[tuple[str, str]]:
    return [(part, name) for part, fields in memory.items() for name in fields]


def test_nothing_in_the_memory_is_left_at_its_beginning_by_a_busy_source() -> None:
    memory, fresh = remembering().remembered(), decoder(preset="cia406").remembered()
    same = [place for place in places(memory) if memory[place[0]][place[1]] == fresh[place[0]][place[1]]]
    assert set(same) <= {("rate", "is_crowded"), ("rate", "crowded_frames"), ("node", "malformed_emergencies")}


@pytest.mark.parametrize("damage", ["missing", "text", "list", "fraction", "huge", "extra"])
@pytest.mark.parametrize("place", places(decoder().remembered()))
def test_a_damaged_memory_is_refused_and_changes_nothing(place: tuple[str, str], damage: str) -> None:
    reader = remembering()
    before = copy.deepcopy(reader.remembered())
    memory = reader.remembered()
    part, name = place
    if damage == "missing":
        del memory[part][name]
    elif damage == "extra":
        memory[part][name + "s"] = 1
    else:
        memory[part][name] = {"text": "7", "list": [], "fraction": float("nan"), "huge": 10**400}[damage]
    with pytest.raises(ValueError, match=r".+"):
        reader.recall(memory)
    assert reader.remembered() == before


@pytest.mark.parametrize("memory", [None, 7, "text", [], {}, {"counter": 1}, {"counter": {}, "rate": {}, "node": {}}])
def test_what_is_no_memory_at_all_is_refused(memory: object) -> None:
    with pytest.raises(ValueError, match=r".+"):
        decoder().recall(memory)


numbers = st.none() | st.integers() | st.floats() | st.booleans()


@settings(derandomize=True, deadline=None, max_examples=300)
@given(st.data())
def test_a_memory_that_is_accepted_never_stops_the_decoder_later(data: st.DataObject) -> None:
    reader = decoder(preset="cia406", counter_signal="speed")
    memory = reader.remembered()
    for part, name in data.draw(st.lists(st.sampled_from(places(memory)), max_size=4)):
        memory[part][name] = data.draw(numbers)
    try:
        reader.recall(memory)
    except ValueError:
        return
    for number in range(20):
        t_ns = number * 200 * MS
        reader.decode(Frame(t_ns, 0x1FF, bytes(4) + bytes([number, 0])))
        reader.report(t_ns)
    reader.report(60_000 * MS)
