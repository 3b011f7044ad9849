"""What people are told about a displacement source."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from drivers.can.cia301 import emergency_words
from drivers.can.displacement import DisplacementDecoder
from drivers.can.frame import Frame
from drivers.condition import OK, Wellness
from tests.drivers.can_kit import MS, decoder, emergency, heartbeat, position, status, taken

SECOND = 1000 * MS


def told(reader: DisplacementDecoder, t_ns: int) -> tuple[Wellness, str, str]:
    """The condition, its word, what and advice."""
    condition = reader.report(t_ns).condition
    return condition.word, condition.what, condition.advice


def send(reader: DisplacementDecoder, times_ns: Iterable[int], first: int = 0) -> None:
    """Good frames of the support controller at these times."""
    for number, t_ns in enumerate(times_ns, first):
        taken(reader, status(100, number % 16), t_ns)


def every(period_ns: int, begin_ns: int, end_ns: int) -> range:
    return range(begin_ns, end_ns, period_ns)


def test_a_source_that_is_well_has_a_rate_an_age_and_nothing_to_say() -> None:
    reader = decoder()
    send(reader, every(50 * MS, 0, 3 * SECOND))
    report = reader.report(3 * SECOND)
    assert report.condition == OK
    assert (report.frames, report.rate_hz, report.age_s) == (60, 20.0, 0.05)
    counters = report.counters()
    assert json.loads(json.dumps(counters)) == counters
    assert "condition" not in counters
    assert {name for name, count in counters.items() if count} == {"frames", "rate_hz", "age_s"}


def test_before_the_first_frame_and_after_the_last_one_the_program_waits() -> None:
    reader = decoder()
    assert told(reader, 0)[:2] == (Wellness.WAITING, "no frame 0x310 yet")
    assert (reader.report(0).rate_hz, reader.report(0).age_s) == (None, None)
    send(reader, [0])
    assert told(reader, SECOND)[0] is Wellness.OK
    word, what, advice = told(reader, 3_200 * MS)
    assert (word, what) == (Wellness.WAITING, "no frame 0x310 for 3.2 s")
    assert "switched on" in advice


OWN_DBC = """VERSION ""
BU_: A
BO_ 291 Status: 4 A
 SG_ Stroke : 0|16@1- (1,0) [0|0] "mm" A
 SG_ State : 16|8@1+ (1,0) [0|0] "" A
VAL_ 291 State 0 "sound" 3 "sensor_cable_broken" ;
"""


@pytest.mark.parametrize(
    ("state", "words"),
    [(3, "the source says: sensor cable broken (State = 3)"), (4, "the source says: not valid (State = 4)")],
)
def test_the_value_table_of_the_dbc_file_puts_the_sources_state_into_words(
    tmp_path: Path, state: int, words: str
) -> None:
    path = tmp_path / "own.dbc"
    path.write_text(OWN_DBC)
    reader = decoder(dbc=path, message="Status", signal="Stroke", valid_signal="State", valid_value=0)
    taken(reader, struct.pack("<hBx", 100, state), 0)
    assert told(reader, MS)[1] == words


def j1939(raw: int, error: int = 0) -> bytes:
    return struct.pack("<HhBBBB", raw, 0, 0, error, 0, 0xFF)


@pytest.mark.parametrize(
    ("options", "frames", "words", "advice"),
    [
        ({}, [bytes(3)], "frames 0x310 have 3 bytes instead of 5: wrong DBC or identifier", "`arbitration_id`"),
        ({}, [b"\0" + status(300, 1)[1:]], "the checksum of frames 0x310 does not fit", "`checksum`"),
        (
            {},
            [status(300, 1), status(300, 1)],
            "the message counter stands still: the controller repeats an old frame",
            "restart the controller",
        ),
        ({}, [status(300, valid=0)], "the source says: invalid (ram_stroke_valid = 0)", "magnet"),
        (
            {"maximum_mm": 600},
            [status(700)],
            "the source shows 700 mm, outside -50 to 600 mm",
            "`maximum_mm`",
        ),
        (
            {},
            [status(300, 1), status(300, 5)],
            "the message counter jumps: 3 frames 0x310 were lost",
            "second sender",
        ),
        (
            {"preset": "j1939_proprietary_b"},
            [j1939(0xFE12)],
            "the source says: error (position = 0xFE12)",
            "manual",
        ),
        (
            {"preset": "j1939_proprietary_b"},
            [j1939(0xFFFF)],
            "the source says: not available (position = 0xFFFF)",
            "manual",
        ),
        (
            {"preset": "j1939_proprietary_b"},
            [j1939(100, 9)],
            "the source says: not valid (error_code = 9)",
            "manual",
        ),
    ],
)
def test_every_fault_is_told_in_words_for_some_seconds_with_what_to_do(
    options: dict[str, Any], frames: list[bytes], words: str, advice: str
) -> None:
    reader = decoder(**options, timeout_ms=60_000)
    for number, data in enumerate(frames):
        taken(reader, data, number)
    word, what, todo = told(reader, 100)
    assert (word, what) == (Wellness.ILL, words)
    assert advice in todo
    assert told(reader, 2 * SECOND)[1] == words
    assert told(reader, 4 * SECOND)[0] is Wellness.OK


def test_a_frame_that_holds_no_number_is_told_as_such(tmp_path: Path) -> None:
    path = tmp_path / "real.dbc"
    path.write_text(
        'VERSION ""\nBU_: A\nBO_ 1 M: 4 A\n SG_ Stroke : 0|32@1- (1,0) [0|0] "m" A\nSIG_VALTYPE_ 1 Stroke : 1;\n'
    )
    reader = decoder(dbc=path, message="M", signal="Stroke")
    taken(reader, struct.pack("<f", float("nan")))
    assert told(reader, 8)[1] == 'signal "Stroke" of frames 0x001 holds no number'


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x5000, "no magnet or another hardware fault (error 0x5000)"),
        (0x6300, "data set error (error 0x6300)"),
        (0x1000, "generic error (error 0x1000)"),
        (0x2310, "current at the output side (error 0x2310)"),
        (0x2F10, "current (error 0x2F10)"),
        (0x3100, "mains voltage (error 0x3100)"),
        (0x4200, "device temperature (error 0x4200)"),
        (0x5112, "device hardware (error 0x5112)"),
        (0x6101, "internal software (error 0x6101)"),
        (0x8130, "heartbeat or life guard missing (error 0x8130)"),
        (0x8199, "communication (error 0x8199)"),
        (0xFF21, "device specific error (error 0xFF21)"),
        (0xA000, "unknown error (error 0xA000)"),
        (0x0000, "an error remains (error register 0x05)"),
    ],
)
def test_emergencies_are_told_in_the_words_of_their_class(code: int, words: str) -> None:
    assert emergency_words(code, 0x05) == words
    reader = decoder(preset="cia406")
    reader.decode(emergency(code, 0x05))
    taken(reader, position(1000), 1)
    assert told(reader, 2)[:2] == (Wellness.ILL, f"the source says: {words}")


def test_a_sensor_that_is_silent_after_an_emergency_has_said_why() -> None:
    reader = decoder(preset="cia406")
    taken(reader, position(1000), 0)
    reader.decode(emergency(0x3100, 0x04, t_ns=MS))
    assert told(reader, 3 * SECOND)[:2] == (
        Wellness.WAITING,
        "the source says: mains voltage (error 0x3100), and sends no position 0x1FF",
    )


@pytest.mark.parametrize(
    ("state", "words", "advice"),
    [
        (0, "node 5 is booting by its heartbeat of 0.5 s ago: it waits to be started", "NMT start"),
        (127, "node 5 is pre-operational by its heartbeat of 0.5 s ago: it waits to be started", "NMT start"),
        (255, "node 5 is pre-operational by its heartbeat of 0.5 s ago: it waits to be started", "1F80h"),
        (4, "node 5 is stopped by its heartbeat of 0.5 s ago: it was stopped", "sends no commands"),
        (5, "node 5 is operational by its heartbeat of 0.5 s ago, but sends no position 0x185", "1800h:05"),
        (9, "node 5 is in state 9 by its heartbeat of 0.5 s ago: it waits", "NMT start"),
    ],
)
@pytest.mark.parametrize("spoke_before", [True, False])
def test_the_heartbeat_of_a_node_that_sends_no_position_says_what_to_do(
    state: int, words: str, advice: str, spoke_before: bool
) -> None:
    reader = decoder(preset="cia406", node_id=5)
    if spoke_before:
        taken(reader, position(1000), 0)
    reader.decode(heartbeat(state, node=5, t_ns=2 * SECOND))
    word, what, todo = told(reader, 2 * SECOND + 500 * MS)
    assert word is Wellness.WAITING
    assert what.startswith(words)
    assert advice in todo


def test_an_old_heartbeat_explains_no_silence() -> None:
    reader = decoder(preset="cia406")
    reader.decode(heartbeat(127, t_ns=0))  # before the master started it
    taken(reader, position(1000), SECOND)
    reader.decode(heartbeat(5, t_ns=SECOND + 100 * MS))  # then it died
    assert told(reader, 9 * SECOND)[1] == "no frame 0x1FF for 8.0 s"


@pytest.mark.parametrize("data", [b"", b"\x05\x00"])
def test_a_heartbeat_of_another_length_is_none(data: bytes) -> None:
    reader = decoder(preset="cia406")
    reader.decode(Frame(0, 0x77F, data))
    assert told(reader, 1)[1] == "no frame 0x1FF yet"


def test_frames_that_come_far_more_often_than_usual_are_counted_and_named_until_they_stop() -> None:
    reader = decoder()
    send(reader, every(100 * MS, 0, 10 * SECOND))
    assert told(reader, 10 * SECOND) == (Wellness.OK, "", "")
    flood = every(10 * MS, 10 * SECOND, 14 * SECOND)
    for number, t_ns in enumerate(flood):  # two senders in turn, each with its own counter
        taken(reader, status(100, (number // 2 + 8 * (number % 2)) % 16), t_ns)
    word, what, advice = told(reader, 14 * SECOND)
    assert word is Wellness.ILL
    assert what.startswith("frames 0x310 come 100 times a second instead of 10: two senders use one identifier")
    assert "restart" in advice
    # All but those of the windows in which the flood began and goes on.
    assert len(flood) - 200 <= reader.report(14 * SECOND).crowded_frames <= len(flood)
    send(reader, every(100 * MS, 14 * SECOND, 18 * SECOND), 500)
    report = reader.report(18 * SECOND)
    assert (report.condition, report.rate_hz) == (OK, 10.0)


def test_a_sender_that_sends_more_often_and_counts_on_is_no_crowd() -> None:
    reader = decoder()
    send(reader, every(500 * MS, 0, 20 * SECOND))
    send(reader, every(20 * MS, 20 * SECOND, 30 * SECOND), 40)
    report = reader.report(30 * SECOND)
    assert (report.condition, report.crowded_frames, report.rate_hz) == (OK, 0, 50.0)


@pytest.mark.parametrize("sign", ["wrong checksum", "repeated", "jump"])
def test_one_wrong_frame_makes_a_crowd_of_its_own_second_only(sign: str) -> None:
    reader, place_of_sign = decoder(), 70
    send(reader, every(500 * MS, 0, 20 * SECOND))
    number = 39
    for place, t_ns in enumerate(every(20 * MS, 20 * SECOND, 30 * SECOND)):
        number += {"repeated": 0, "jump": 3}.get(sign, 1) if place == place_of_sign else 1
        data = bytearray(status(100, number % 16))
        data[-1] ^= sign == "wrong checksum" and place == place_of_sign
        taken(reader, bytes(data), t_ns)
    assert reader.report(30 * SECOND).crowded_frames == 50


def test_a_rate_that_is_a_few_times_the_usual_one_is_learned_instead() -> None:
    reader = decoder()
    send(reader, every(100 * MS, 0, 10 * SECOND))
    send(reader, every(25 * MS, 10 * SECOND, 30 * SECOND), 100)
    assert reader.report(30 * SECOND).crowded_frames == 0
    # 40 Hz is usual by now: 6 times 10 Hz are no flood any more.
    send(reader, every(16 * MS, 30 * SECOND, 34 * SECOND), 100 + 800)
    assert reader.report(34 * SECOND).crowded_frames == 0


def test_copies_that_come_at_once_make_no_flood() -> None:
    reader = decoder()
    for t_ns in every(100 * MS, 0, 20 * SECOND):
        for copy in range(4):
            taken(reader, status(100, t_ns // MS // 100 % 16), t_ns + copy)
    report = reader.report(20 * SECOND)
    assert (report.crowded_frames, report.repeated) == (0, 600)
    assert report.rate_hz == pytest.approx(40, rel=0.1)


def test_a_slow_source_has_a_rate_too() -> None:
    reader = decoder(timeout_ms=10_000)
    send(reader, every(2 * SECOND, 0, 30 * SECOND))
    assert reader.report(30 * SECOND).rate_hz == 0.5


def test_after_a_silence_the_rate_is_unknown_until_frames_have_come_for_a_while() -> None:
    reader = decoder()
    send(reader, every(100 * MS, 0, 3 * SECOND))
    send(reader, [60 * SECOND], 30)
    assert (reader.report(60 * SECOND).rate_hz, reader.report(60 * SECOND).condition) == (None, OK)
    send(reader, every(100 * MS, 60 * SECOND + 100 * MS, 62 * SECOND), 31)
    assert reader.report(62 * SECOND).rate_hz == 10.0
