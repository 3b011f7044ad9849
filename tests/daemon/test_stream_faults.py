"""From what is wrong with a CAN frame to what the estimate says of the sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from daemon.recording import topics
from daemon.recording.topics import Recorded
from daemon.settings import Settings
from daemon.stream import Stream
from drivers.can.frame import Frame
from drivers.virtual.controller import VirtualController
from estimation.pipeline import Start
from estimation.records import CanState, ImuSample

PERIOD_NS = 1_220_703
SAMPLES_PER_FRAME = 50
TRUE_M, WRONG_M = 0.1, 0.3


def ignore(topic: str, record: Recorded) -> None:
    """A sink."""


def frames_of(value_m: float) -> Iterator[Frame]:
    """Sound frames of the controller, one for each of the times."""
    period_ns = PERIOD_NS * SAMPLES_PER_FRAME
    controller = VirtualController((number * period_ns, value_m) for number in range(100))
    while controller.next_t_ns is not None:
        yield from controller.due(controller.next_t_ns)


def sound(frame: Frame) -> Frame:
    return frame


def flipped(frame: Frame) -> Frame:
    return replace(frame, data=bytes([frame.data[0] ^ 0x80]) + frame.data[1:])


def cut_short(frame: Frame) -> Frame:
    return replace(frame, data=frame.data[:4])


def frozen(frame: Frame) -> Frame:
    return replace(next(frames_of(WRONG_M)), t_ns=frame.t_ns)


def state_after(harm: Callable[[Frame], Frame], value_m: float) -> tuple[CanState, float, dict[str, int]]:
    """State and stroke at rest, 1.2 s of sound frames and then 0.8 s of harmed ones that show `value_m`."""
    stream = Stream(Settings(), ignore, Start())
    good, bad = frames_of(TRUE_M), frames_of(value_m)
    for number in range(1640):
        if number % SAMPLES_PER_FRAME == 0:
            frames = next(good), next(bad)
            stream.take(topics.CAN_RX, frames[0] if number < 1000 else harm(frames[1]))
        stream.take(topics.IMU_SAMPLE, ImuSample(number * PERIOD_NS, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)))
    assert stream.last is not None
    counters = stream.decoders[0].report(stream.last.t_ns).counters()
    return stream.last.can_state, stream.last.displacement_m, counters


@pytest.mark.parametrize(
    ("harm", "value_m", "state", "counter", "count"),
    [
        (sound, TRUE_M, CanState.OK, "malformed", 0),
        (flipped, WRONG_M, CanState.INVALID, "checksum", 13),
        (cut_short, WRONG_M, CanState.INVALID, "malformed", 13),
        (sound, float("nan"), CanState.INVALID, "invalid", 13),
        (sound, 2.0, CanState.OUT_OF_RANGE, "out_of_range", 13),
    ],
)
def test_a_faulty_frame_is_counted_told_and_not_estimated_from(
    harm: Callable[[Frame], Frame], value_m: float, state: CanState, counter: str, count: int
) -> None:
    told, displacement_m, counters = state_after(harm, value_m)
    assert (told, counters[counter]) == (state, count)
    assert displacement_m == pytest.approx(TRUE_M, abs=0.002)


def test_a_sender_that_freezes_at_rest_is_called_stuck_by_its_counter_alone() -> None:
    told, displacement_m, counters = state_after(frozen, WRONG_M)
    # The first frame that it repeats may still look like a new one.
    assert (told, counters["repeated"]) == (CanState.STUCK, 12)
    assert displacement_m == pytest.approx(TRUE_M, abs=0.002)
