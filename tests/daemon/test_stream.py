"""One way from received records to outputs, whatever was received and however it was handed over."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest

from daemon.machine import machine_of
from daemon.offline.replaying.replay import settings_of
from daemon.recording import topics
from daemon.recording.metadata import LEARNED, SNAPSHOT
from daemon.recording.reader import Recording
from daemon.recording.topics import TOPICS, Recorded, RecordedDisplacement
from daemon.settings import Settings
from daemon.stream import INPUTS, Stream
from drivers.adis16448.burst import Burst, Fault
from drivers.adis16448.identity import Identity
from drivers.can.frame import Frame
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.reading import Reading
from drivers.virtual.controller import VirtualController
from estimation.pipeline import Start
from estimation.records import Displacement, Event, ImuSample, ReadingFault, Tick, TimeKind
from tests.conftest import DemoRun

REST = ImuSample(0, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8))
SECONDS = 14  # of the demo: its push begins at 10 s


class Sink:
    """Keeps what the stream gives, encoded: NaN equals NaN, nothing is rounded."""

    def __init__(self) -> None:
        self.taken: list[tuple[str, bytes]] = []
        self.records: list[tuple[str, Recorded]] = []

    def __call__(self, topic: str, record: Recorded) -> None:
        self.taken.append((topic, TOPICS[topic].encode(record)))
        self.records.append((topic, record))

    def of(self, *wanted: str) -> list[bytes]:
        return [data for topic, data in self.taken if topic in wanted]


@pytest.fixture(scope="module")
def beginning(demo_run: DemoRun) -> list[tuple[str, Recorded]]:
    """The first inputs of the demo, in the order in which they were received."""
    end_ns = SECONDS * 1e9

    def inputs() -> Iterator[tuple[str, Recorded]]:
        for topic, record in Recording(demo_run.recording).messages((topics.IMU_RAW, topics.CAN_RX)):
            if TOPICS[topic].time_ns(record) > end_ns:
                return
            yield topic, record

    return list(inputs())


@pytest.fixture(scope="module")
def demo_settings(demo_run: DemoRun) -> Settings:
    return settings_of(Recording(demo_run.recording))


def in_blocks(inputs: list[tuple[str, Recorded]], size: int) -> Iterator[list[tuple[str, Recorded]]]:
    """As a driver hands them over: `size` bursts at a time; a frame ends a block, so that its place is kept."""
    block: list[tuple[str, Recorded]] = []
    for topic, record in inputs:
        if topic == topics.CAN_RX and block:
            yield block
            block = []
        block.append((topic, record))
        if len(block) == size or topic == topics.CAN_RX:
            yield block
            block = []
    if block:
        yield block


def run(settings: Settings, blocks: Iterable[list[tuple[str, Recorded]]]) -> Sink:
    sink = Sink()
    stream = Stream(settings, sink, Start(0.0))
    for block in blocks:
        for topic, record in block:
            stream.take(topic, record)
    stream.finish()
    return sink


def test_blocks_of_any_size_give_the_same_bytes(beginning: list[tuple[str, Recorded]], demo_settings: Settings) -> None:
    ones = run(demo_settings, in_blocks(beginning, 1))
    assert len(ones.of(topics.PROVISIONAL)) == len(ones.of(topics.SETTLED)) > SECONDS * 95
    assert any(isinstance(r, Event) and "start" in r.what for _, r in ones.records)
    for size in (13, 64):
        assert run(demo_settings, in_blocks(beginning, size)).taken == ones.taken


def test_a_snapshot_taken_anywhere_goes_on_with_the_same_bytes(
    beginning: list[tuple[str, Recorded]], demo_settings: Settings
) -> None:
    whole = run(demo_settings, [beginning])
    # In the first second, at rest, in the middle of a step, and in the push.
    for place in (0, 500, 5003, len(beginning) - 4000):
        first, second = Sink(), Sink()
        before = Stream(demo_settings, first, Start(0.0))
        for topic, record in beginning[:place]:
            before.take(topic, record)
        after = Stream(demo_settings, second)
        after.restore(before.snapshot())
        for topic, record in beginning[place:]:
            after.take(topic, record)
        after.finish()
        assert first.taken + second.taken == whole.taken, place


def test_what_was_learned_and_the_snapshot_beside_it_are_of_the_same_moment(
    demo_run: DemoRun, demo_settings: Settings
) -> None:
    """At the head of a file that begins before, within and after a move."""
    push_stop_s = demo_run.report["moves"][0]["stop_s"]
    places_s = [20.0, push_stop_s + 1.0, push_stop_s + 6.0]
    stream = Stream(demo_settings, Sink(), Start(0.0))
    strokes: list[int] = []
    for topic, record in Recording(demo_run.recording).messages((topics.IMU_IDENTITY, topics.IMU_RAW, topics.CAN_RX)):
        stream.take(topic, record)
        if TOPICS[topic].time_ns(record) > places_s[len(strokes)] * 1e9:
            head = stream.attachments()
            resumed = Stream(demo_settings, Sink())
            resumed.restore(head[SNAPSHOT])
            assert resumed.attachments() == head
            learned = resumed.learned()
            assert head[LEARNED] == (b"{}" if learned is None else learned.model_dump_json().encode())
            strokes.append(0 if learned is None else learned.calibrations)
            if len(strokes) == len(places_s):
                break
    assert strokes == [0, 0, 1]
    assert learned is not None
    assert stream.identity is not None
    assert learned.machine == machine_of(demo_settings).model_copy(update={"inertial_part": stream.identity.name})


def test_every_input_comes_out_first_and_once_then_what_it_brought_about(
    beginning: list[tuple[str, Recorded]], demo_settings: Settings
) -> None:
    sink = run(demo_settings, [beginning[:3000]])
    assert [(t, r) for t, r in sink.records if t in (topics.IMU_RAW, topics.CAN_RX)] == beginning[:3000]
    for (topic, record), (following, reading) in zip(sink.records, sink.records[1:], strict=False):
        if following in (topics.OBSERVED, topics.REFERENCE):
            assert topic == topics.CAN_RX
            assert isinstance(reading, RecordedDisplacement)
            assert isinstance(record, Frame)
            assert reading.decoded
            assert reading.reading.t_ns == record.t_ns
    observed = [r for t, r in sink.records if t == topics.OBSERVED]
    references = [r for t, r in sink.records if t == topics.REFERENCE]
    assert len(observed) + len(references) == sum(t == topics.CAN_RX for t, _ in beginning[:3000])
    assert len(references) > len(observed) > 0


def test_a_reference_is_never_estimated_from(beginning: list[tuple[str, Recorded]], demo_settings: Settings) -> None:
    laboratory = 0x311
    without = [(t, r) for t, r in beginning if not (isinstance(r, Frame) and r.arbitration_id == laboratory)]
    assert len(without) < len(beginning)
    estimates = (topics.PROVISIONAL, topics.SETTLED, topics.EVENTS)
    assert run(demo_settings, [without]).of(*estimates) == run(demo_settings, [beginning]).of(*estimates)


def test_a_bad_burst_is_counted_and_passed_on_but_not_estimated_from() -> None:
    sink = Sink()
    stream = Stream(Settings(), sink)
    words = (0,) * 6 + (11771,) + (0,) * 5
    for number in range(800):
        fault = Fault.CRC if number % 100 == 99 else Fault.NONE
        stream.take(topics.IMU_RAW, Burst(number * 1_220_703, TimeKind.EDGE, words, None, fault))
    assert (stream.samples, stream.bad_bursts) == (792, 8)
    assert len(sink.of(topics.IMU_RAW)) == 800
    assert len(sink.of(topics.PROVISIONAL)) == 792 // 8
    assert stream.last is not None
    assert stream.last_sample_ns == 798 * 1_220_703


def test_a_decoded_displacement_is_not_counted_twice() -> None:
    def readings_used(decoded: bool) -> bool:
        stream = Stream(Settings(), Sink(), Start())
        for number in range(820):
            t_ns = number * 1_220_703
            if number % 50 == 0:
                stream.take(topics.OBSERVED, RecordedDisplacement(Displacement(t_ns, 0.4), decoded))
            stream.take(topics.IMU_SAMPLE, ImuSample(t_ns, REST.gyro, REST.accel))
        assert stream.last is not None
        return abs(stream.last.displacement_m - 0.4) < 0.02

    assert readings_used(decoded=False)
    assert not readings_used(decoded=True)


def test_time_goes_on_while_the_sensor_is_silent() -> None:
    sink = Sink()
    stream = Stream(Settings(), sink, Start(0.1))
    for number in range(1640):
        stream.take(topics.IMU_SAMPLE, ImuSample(number * 1_220_703, REST.gyro, REST.accel))
    last_ns = 1639 * 1_220_703
    before = stream.last
    for number in range(1, 11):
        stream.take(topics.TICK, Tick(last_ns + number * 100_000_000))
    assert before is not None
    assert stream.last is not None
    assert stream.last.t_ns > before.t_ns
    assert stream.last.sigma_m > before.sigma_m
    assert len(sink.of(topics.EVENTS)) == 1


CIA406 = Settings.model_validate({"can": {"displacement": {"preset": "cia406"}}})
EMERGENCY = Frame(1_000, 0x80 + 127, bytes([0x00, 0x50, 0x01, 0, 0, 0, 0, 0]))


def faults(sink: Sink) -> list[ReadingFault]:
    """Of the readings that came out."""
    return [r.reading.fault for _, r in sink.records if isinstance(r, RecordedDisplacement)]


def test_an_emergency_of_the_sensor_survives_a_snapshot() -> None:
    before = Stream(CIA406, Sink())
    before.take(topics.CAN_RX, EMERGENCY)
    after = Stream(CIA406, sink := Sink())
    after.restore(before.snapshot())
    after.take(topics.CAN_RX, Frame(2_000, 0x180 + 127, bytes(8)))
    assert faults(sink) == [ReadingFault.INVALID]


def test_a_frozen_counter_is_noticed_across_a_snapshot() -> None:
    frame = VirtualController([(1_000, 0.1)]).due(1_000)[0]
    before = Stream(Settings(), Sink())
    before.take(topics.CAN_RX, frame)
    after = Stream(Settings(), sink := Sink())
    after.restore(before.snapshot())
    after.take(topics.CAN_RX, replace(frame, t_ns=100_000_000))
    assert faults(sink) == [ReadingFault.REPEATED]


def snapshot_with(**head: object) -> bytes:
    """A snapshot of a stream with one decoder, with other things in its head."""
    mine, _, state = Stream(CIA406, Sink()).snapshot().partition(b"\n")
    return json.dumps(json.loads(mine) | head).encode() + b"\n" + state


def test_the_snapshot_that_the_foreign_ones_are_made_of_is_accepted() -> None:
    Stream(CIA406, Sink()).restore(snapshot_with())


FOREIGN_SNAPSHOTS = {
    "empty": b"",
    "no JSON": b"\x00\xff",
    "half": snapshot_with()[:-10],
    "no decoders": b"{}\n{}",
    "a list": b"[]\n{}",
    "a number": b"7\n{}",
    "decoders of another kind": snapshot_with(decoders=3),
    "too many decoders": snapshot_with(decoders=[{}, {}, {}]),
    "an empty decoder": snapshot_with(decoders=[{}]),
    "a decoder in words": snapshot_with(decoders=["ill"]),
    "a decoder in a list": snapshot_with(decoders=[[]]),
    "an identity in words": snapshot_with(identity="mine"),
    "half an identity": snapshot_with(identity={"t_ns": 7}),
    "deeply nested": b"[" * 100_000 + b"\n{}",
    "state of another kind": snapshot_with().partition(b"\n")[0] + b"\n[]",
}


@pytest.mark.parametrize("what", FOREIGN_SNAPSHOTS)
def test_a_foreign_snapshot_is_refused(what: str) -> None:
    with pytest.raises(ValueError, match=r".+"):
        Stream(CIA406, Sink()).restore(FOREIGN_SNAPSHOTS[what])


def test_a_snapshot_is_json_a_line_each_for_devices_and_pipeline() -> None:
    stream = Stream(CIA406, Sink())
    head, state = stream.snapshot().split(b"\n")
    assert json.loads(head) == {"decoders": [stream.decoders[0].remembered()], "identity": None}
    assert isinstance(json.loads(state), dict)


HOSTILE_VALUES = [math.nan, math.inf, -math.inf, 1e308, -1e308, 1e30]


@pytest.mark.parametrize("value", HOSTILE_VALUES)
def test_no_displacement_whatever_stops_the_stream_or_is_believed(value: float) -> None:
    stream = Stream(Settings(), Sink(), Start(0.1))
    for number in range(1640):
        t_ns = number * 1_220_703
        if number % 50 == 0:
            reading = Displacement(t_ns, value, ReadingFault.NONE if number % 100 == 0 else ReadingFault.INVALID)
            stream.take(topics.OBSERVED, RecordedDisplacement(reading, decoded=False))
        stream.take(topics.IMU_SAMPLE, ImuSample(t_ns, REST.gyro, REST.accel))
    stream.finish()
    assert stream.last is not None
    assert stream.last.displacement_m == pytest.approx(0.1, abs=0.001)


@pytest.mark.parametrize("value", HOSTILE_VALUES)
@pytest.mark.parametrize("place", range(6))
def test_an_impossible_sample_is_counted_and_not_estimated_from(value: float, place: int) -> None:
    readings = [0.0, 0.0, 0.0, 0.0, 0.0, 9.8]
    readings[place] = value
    stream = Stream(Settings(), sink := Sink(), Start(0.1))
    for number in range(1640):
        gx, gy, gz, ax, ay, az = readings if number % 400 == 399 else (*REST.gyro, *REST.accel)
        stream.take(topics.IMU_SAMPLE, ImuSample(number * 1_220_703, (gx, gy, gz), (ax, ay, az)))
    stream.finish()
    assert (stream.samples, stream.bad_bursts, len(sink.of(topics.IMU_SAMPLE))) == (1636, 4, 1640)
    assert stream.last is not None
    assert stream.last.displacement_m == pytest.approx(0.1, abs=0.001)


def test_the_topics_that_a_replay_feeds_are_those_that_the_stream_takes(demo_run: DemoRun) -> None:
    """Whatever else is in a recording follows from its inputs."""
    counts = Recording(demo_run.recording)
    assert list(islice(counts.messages(INPUTS), 1))
    sink = Sink()
    stream = Stream(Settings(), sink)
    one_of_each: dict[str, Recorded] = {
        topics.IMU_IDENTITY: Identity(0, 16448, 1, 2),
        topics.IMU_RAW: Burst(0, TimeKind.EDGE, (0,) * 12, None),
        topics.IMU_SAMPLE: REST,
        topics.JY901_IDENTITY: Jy901Identity(0, 1, 115200, 200.0),
        topics.JY901: Reading(0, (0, 0, 2048, 0), (0, 0, 0, 0)),
        topics.CAN_RX: Frame(0, 0x7FF, b""),
        topics.OBSERVED: RecordedDisplacement(Displacement(0, 0.1), decoded=False),
        topics.REFERENCE: RecordedDisplacement(Displacement(0, 0.1, is_reference=True), decoded=False),
        topics.TICK: Tick(0),
    }
    for topic, record in one_of_each.items():
        stream.take(topic, record)
    assert [topic for topic, _ in sink.records] == list(INPUTS)


def test_a_wrong_dbc_is_refused_before_anything_flows(tmp_path: Path) -> None:
    wrong = {"dbc": str(tmp_path / "none.dbc"), "message": "m", "signal": "s"}
    with pytest.raises(ValueError, match=r"none\.dbc"):
        Stream(Settings.model_validate({"can": {"displacement": wrong}}), Sink())
