from __future__ import annotations

import logging

import pytest

from drivers.clock import VirtualClock
from drivers.quiet_log import QuietLog


def quiet() -> tuple[QuietLog, VirtualClock]:
    clock = VirtualClock()
    return QuietLog(logging.getLogger("quiet"), clock), clock


def test_the_same_sentence_is_said_once_in_ten_seconds_and_its_repetitions_counted(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    log, clock = quiet()
    for _ in range(95):
        log.say(logging.INFO, "it flaps")
        clock.sleep(0.1)
        log.flush()
    assert caplog.messages == ["it flaps"]
    clock.sleep(1.0)
    log.flush()
    assert caplog.messages == ["it flaps", "it flaps (94 times)"]
    clock.sleep(20.0)
    log.flush()
    assert len(caplog.messages) == 2


def test_the_last_line_is_the_last_thing_that_happened(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    log, clock = quiet()
    for sentence in ("bad", "good", "bad", "good", "new", "bad", "good"):
        log.say(logging.INFO, sentence)
        clock.sleep(0.5)
    assert caplog.messages == ["bad", "good"]
    clock.sleep(10.0)
    log.flush()
    assert caplog.messages == ["bad", "good", "new", "bad (2 times)", "good (2 times)"]


def test_what_is_held_back_is_said_at_the_end(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    log, _ = quiet()
    log.say(logging.WARNING, "bad")
    log.say(logging.WARNING, "bad")
    log.flush(at_end=True)
    assert caplog.messages == ["bad", "bad"]
    assert [record.levelno for record in caplog.records] == [logging.WARNING] * 2


def test_sentences_that_never_come_again_are_forgotten() -> None:
    log, clock = quiet()
    for number in range(1000):
        log.say(logging.INFO, f"number {number}")
        clock.sleep(1.0)
    assert len(log._said) <= 64
