"""How the parts are, since when, and what is said about it."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from daemon.recording.recorder import Recorder
from daemon.recording.settings import RecorderSettings
from daemon.service.health import (
    LOG_EVERY_S,
    TOLD_S,
    HealthBook,
    RecorderHealth,
    displacement_condition,
    estimate_condition,
    loop_condition,
    status_line,
)
from daemon.service.loop_watch import Lateness
from drivers.condition import OFF, OK, Condition, Wellness
from estimation.records import CanState, Estimate, Segment, Tier

DOWN = Condition(Wellness.WAITING, "can0 is down", "ip link set can0 up")
NOISY = Condition(Wellness.ILL, "7 error frames a second", "check the termination")
ESTIMATE = Estimate(0, 0.3, 0.002, 0.0, 0.0, Segment.ZUPT, Tier.PROVISIONAL, CanState.OK, 0, *[0.0] * 6)


def texts(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records]


def test_since_is_the_time_of_the_last_change_of_state_not_of_numbers() -> None:
    book = HealthBook()
    assert book.note("can", OK, 10.0)["since_s"] == 10.0
    assert book.note("can", NOISY, 20.0)["since_s"] == 20.0
    louder = replace(NOISY, what="130 error frames a second")
    row = book.note("can", louder, 30.0)
    assert row == {"state": "ill", "since_s": 20.0, "what": louder.what, "advice": louder.advice}
    assert book.note("can", DOWN, 40.0)["since_s"] == 40.0


def test_what_is_closed_at_the_end_is_not_logged(caplog: pytest.LogCaptureFixture) -> None:
    book = HealthBook()
    book.note("can", OK, 10.0)
    book.is_ending = True
    assert book.note("can", DOWN, 30.0)["state"] == "waiting"
    assert texts(caplog) == []


def test_each_change_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    book = HealthBook()
    for second in range(100):
        book.note("can", DOWN if 20 <= second < 60 else OK, float(second))
    assert texts(caplog) == ["can: can0 is down; ip link set can0 up", "can: well again"]
    assert [record.levelno for record in caplog.records] == [logging.WARNING, logging.INFO]


def test_a_loose_plug_is_not_logged_at_every_contact_but_counted(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    book = HealthBook()
    for second in range(600):
        book.note("can", DOWN if second % 2 else OK, float(second))
    lines = texts(caplog)
    assert 20 <= len(lines) <= 600 / LOG_EVERY_S + 1
    assert "changes in the last" in lines[1]


def test_a_part_that_recovers_between_two_lines_is_told_well_in_the_end(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    book = HealthBook()
    for second in range(40):
        book.note("imu", DOWN if second == 10 else OK, float(second))
    assert texts(caplog) == [f"imu: {DOWN.what}; {DOWN.advice}", "imu: well again"]


def test_what_is_still_waiting_for_its_start_is_not_complained_of_at_once(caplog: pytest.LogCaptureFixture) -> None:
    book = HealthBook()
    for second in range(3):
        book.note("can", DOWN, float(second))
    assert not caplog.records
    for second in range(3, 6):
        book.note("can", DOWN, float(second))
    assert len(caplog.records) == 1


def test_the_whole_is_as_its_worst_part() -> None:
    book = HealthBook()
    assert book.worst() is Wellness.OK
    book.note("recorder", OFF, 0.0)
    book.note("loop", OK, 0.0)
    assert book.worst() is Wellness.OK
    book.note("imu", NOISY, 0.0)
    assert book.worst() is Wellness.ILL
    book.note("can", DOWN, 0.0)
    assert book.worst() is Wellness.WAITING


@pytest.mark.parametrize("state", list(CanState))
def test_every_state_of_the_displacement_sensor_has_words_unless_it_is_well(state: CanState) -> None:
    condition = displacement_condition(state, OK)
    if state in (CanState.OK, CanState.LATE):
        assert condition == OK
    else:
        assert condition.word in (Wellness.ILL, Wellness.WAITING)
        assert condition.what
        assert condition.advice


def test_what_the_frames_say_goes_before_what_the_estimator_guesses() -> None:
    assert displacement_condition(CanState.INVALID, NOISY) == NOISY
    assert displacement_condition(None, DOWN) == DOWN


def test_an_undetermined_stroke_is_said_to_be() -> None:
    assert estimate_condition(None, 0.5).word is Wellness.WAITING
    assert estimate_condition(ESTIMATE, 0.5) == OK
    unknown = replace(ESTIMATE, sigma_m=0.5 / 12**0.5)
    assert "undetermined" in estimate_condition(unknown, 0.5).what


def test_a_late_loop_names_its_culprit() -> None:
    assert loop_condition(Lateness(0.05, "inertial samples", 0.04)) == OK
    said = loop_condition(Lateness(0.25, "inertial samples", 0.2)).what
    assert said == "the event loop was 250 ms late: inertial samples (200 ms)"


def test_the_recorder_is_well_only_while_everything_reaches_the_disk(tmp_path: Path) -> None:
    recorder = Recorder(RecorderSettings(directory=tmp_path), lambda: None)  # type: ignore[arg-type,return-value]  # never started
    assert RecorderHealth(recorder, enabled=False).condition(0.0) == OFF
    health = RecorderHealth(recorder, enabled=True)
    assert health.condition(0.0).word is Wellness.WAITING
    recorder.counters.file = "x.mcap"
    assert health.condition(1.0) == OK
    recorder.counters.dropped_queue_full = 7
    assert health.condition(2.0).what == "7 messages are not recorded"
    assert health.condition(2.0 + TOLD_S / 2).word is Wellness.ILL
    assert health.condition(2.0 + TOLD_S) == OK


def test_the_status_line_has_the_stroke_the_ailing_parts_and_the_laggards() -> None:
    parts: dict[str, Any] = {
        "estimate": {"displacement_mm": 312.44, "sigma_mm": 2.06, "segment": "CVS"},
        "imu": {"state": "ok", "what": ""},
        "can": {"state": "waiting", "what": DOWN.what},
        "live": {"viewers": 1},
    }
    assert status_line(parts, {"imu": 5.2}) == (
        "312.4 ± 2.1 mm, CVS; can waiting: can0 is down; imu has stood still for 5 s"
    )
    assert status_line({"estimate": None}, {}) == "no estimate yet"
