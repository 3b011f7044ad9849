"""The recorder keeps order, never waits for the disk, and accounts for every message."""

from __future__ import annotations

import io
import json
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import pytest
from pydantic import ValidationError

from daemon.recording import background_sync, recorder, retention, topics
from daemon.recording.metadata import LEARNED, SNAPSHOT, Preamble, describe, wall_offset_ns
from daemon.recording.reader import Recording
from daemon.recording.recorder import Recorder
from daemon.recording.recover import recover
from daemon.recording.settings import RecorderSettings
from daemon.recording.topics import LogLine
from estimation.records import Event, Tick
from tests.daemon.recording_kit import (
    ATTACHMENTS,
    METADATA,
    ONE_OF_EACH,
    SmallDisk,
    burst,
    number_of,
    passes_official_reader,
)

HEAD = Preamble(METADATA, ATTACHMENTS)
PATIENCE_S = 20.0


def settings_for(directory: Path, **changes: Any) -> RecorderSettings:
    return RecorderSettings(directory=directory, flush_interval_ms=1, keep_free_mb=0, **changes)


def wait_until(condition: Callable[[], bool]) -> None:
    """Let the writer thread work until `condition` holds."""
    pause = threading.Event()
    for _ in range(round(PATIENCE_S / 0.001)):
        if condition():
            return
        pause.wait(0.001)
    raise AssertionError("waited in vain")


def recordings_in(directory: Path) -> list[Recording]:
    return [Recording(path) for path in retention.recordings(directory)]


def test_what_is_written_is_in_a_whole_file_in_the_order_of_writing(tmp_path: Path) -> None:
    made = Recorder(settings_for(tmp_path / "new" / "folder"), lambda: HEAD)
    made.start()
    for _ in range(5):
        for topic, record in ONE_OF_EACH.items():
            made.write(topic, record)
    assert made.close()
    (recording,) = recordings_in(tmp_path / "new" / "folder")
    assert [topic for topic, _ in recording.messages()] == list(ONE_OF_EACH) * 5
    assert (recording.complete, recording.damage, recording.lost) == (True, [], 0)
    assert (recording.metadata, recording.attachments) == (METADATA, ATTACHMENTS)
    counters = made.counters
    assert (counters.messages, counters.dropped, counters.errors, counters.files) == (5 * len(ONE_OF_EACH), 0, 0, 1)
    assert counters.bytes < recording.path.stat().st_size  # the index comes on top
    assert (counters.file, made.queued) == ("", 0)


def test_a_recorder_that_is_switched_off_or_closed_takes_nothing(tmp_path: Path) -> None:
    off = Recorder(settings_for(tmp_path, enabled=False), lambda: HEAD)
    off.start()
    off.write(topics.TICK, Tick(1))
    assert off.close()
    assert list(tmp_path.iterdir()) == []
    on = Recorder(settings_for(tmp_path), lambda: HEAD)
    on.start()
    assert on.close()
    on.write(topics.TICK, Tick(1))
    assert (on.counters.messages, on.queued) == (0, 0)


def test_each_file_begins_with_an_input_and_the_state_just_before_it(tmp_path: Path) -> None:
    handed = 0

    def head() -> Preamble:
        return Preamble(describe("recording", "{}"), {SNAPSHOT: str(handed).encode(), LEARNED: b"{}"})

    three, opened = threading.Event(), []

    def open_file(path: Path) -> BinaryIO:
        stream = path.open("xb")
        opened.append(path)
        if len(opened) == 3:
            three.set()
        return stream

    made = Recorder(settings_for(tmp_path, rotate_mb=0.02), head, open_file=open_file)
    made.start()
    while not three.wait(0.0002):  # lets the writer thread keep up
        made.write(topics.IMU_RAW, burst(handed))
        handed += 1
        made.write(topics.EVENTS, Event(handed, "output"))
        made.write(topics.OBSERVED, ONE_OF_EACH[topics.OBSERVED])
    assert made.close()
    assert made.counters.dropped == 0
    next_number = 0
    for path in opened:
        recording = Recording(path)
        assert recording.attachments[SNAPSHOT] == str(next_number).encode()
        messages = list(recording.messages())
        assert (recording.complete, recording.lost) == (True, 0)
        if messages:  # the last one may have come too late for anything
            assert messages[0][0] == topics.IMU_RAW
        numbers = [number_of(record) for topic, record in messages if topic == topics.IMU_RAW]
        assert numbers == list(range(next_number, next_number + len(numbers)))
        assert recording.counts[topics.EVENTS] == recording.counts[topics.OBSERVED] == len(numbers)
        next_number += len(numbers)
    assert next_number == handed
    assert made.counters.files == len(opened)


class HungDisk:
    """A disk that does not answer until it is released."""

    def __init__(self) -> None:
        self.reached, self.released = threading.Event(), threading.Event()

    def open(self, path: Path) -> BinaryIO:
        disk = self

        class File(io.FileIO):
            def write(self, data: Any) -> int:
                disk.reached.set()
                assert disk.released.wait(PATIENCE_S)
                return super().write(data)

        return io.BufferedWriter(File(path, "xb"))


def test_a_hung_disk_never_makes_write_wait_and_the_drops_are_counted_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recorder, "MAX_QUEUED_MESSAGES", 50)
    disk = HungDisk()
    made = Recorder(settings_for(tmp_path), lambda: HEAD, open_file=disk.open)
    made.start()
    assert disk.reached.wait(PATIENCE_S)
    for number in range(80):  # returns although nothing can be written
        made.write(topics.IMU_RAW, burst(number))
    assert made.counters.dropped_queue_full == 30
    assert made.queued == 50
    assert not made.close(timeout_s=0.01)
    disk.released.set()
    assert made.close(PATIENCE_S)
    (recording,) = recordings_in(tmp_path)
    assert [number_of(record) for _, record in recording.messages()] == list(range(50))
    assert made.counters.messages + made.counters.dropped == 80


def test_drops_are_said_and_stay_visible_as_missing_sequence_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    disk = HungDisk()
    made = Recorder(settings_for(tmp_path), lambda: HEAD, open_file=disk.open)
    said = threading.Event()
    monkeypatch.setattr(recorder._log, "warning", lambda *args: said.set())
    made.start()
    assert disk.reached.wait(PATIENCE_S)
    monkeypatch.setattr(recorder, "MAX_QUEUED_BYTES", 4 * 50)  # bytes count as well as messages
    for number in range(10):
        made.write(topics.IMU_RAW, burst(number))
    kept = made.queued
    assert 0 < kept < 10
    disk.released.set()
    assert said.wait(PATIENCE_S)
    wait_until(lambda: made.counters.messages == kept)
    made.write(topics.IMU_RAW, burst(10))
    assert made.close(PATIENCE_S)
    (recording,) = recordings_in(tmp_path)
    assert [number_of(record) for _, record in recording.messages()] == [*range(kept), 10]
    assert recording.lost == made.counters.dropped == 10 - kept


def test_a_full_disk_is_survived_and_recording_resumes_in_a_new_file(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    disk = SmallDisk(12_000)
    full, resumed = threading.Event(), threading.Event()

    def open_file(path: Path) -> BinaryIO:
        if full.is_set():
            resumed.set()
        return disk.open(path)

    def head() -> Preamble:
        return Preamble(METADATA, {SNAPSHOT: str(number).encode()})

    number = 0
    made = Recorder(settings_for(tmp_path), head, open_file=open_file)
    made.start()
    while not made.counters.errors:
        made.write(topics.IMU_RAW, burst(number))
        number += 1
        resumed.wait(0.0002)  # lets the writer thread keep up
    assert "No space left" in made.counters.last_error
    disk.room = 10_000_000
    full.set()
    while not resumed.is_set():  # asked again every second
        made.write(topics.IMU_RAW, burst(number))
        number += 1
        resumed.wait(0.001)
    made.write(topics.IMU_RAW, burst(number))
    number += 1
    assert made.close(PATIENCE_S)
    found = [
        (recording.attachments[SNAPSHOT], [number_of(record) for _, record in recording.messages()])
        for recording in recordings_in(tmp_path)
    ]
    *before, (snapshot, last) = found
    assert last == list(range(int(snapshot), number))
    for _, numbers in before:  # nothing torn: cut back to what was counted as written
        assert numbers == list(range(len(numbers)))
    assert sum(len(numbers) for _, numbers in found) == made.counters.messages
    assert made.counters.messages + made.counters.dropped_no_disk == number
    words = [record.getMessage() for record in caplog.records]
    assert sum("recording stopped" in line for line in words) == 1
    assert sum("recording again" in line for line in words) == 1


def test_a_record_that_fits_no_schema_is_counted_and_the_rest_is_recorded(tmp_path: Path) -> None:
    made = Recorder(settings_for(tmp_path), lambda: HEAD)
    made.start()
    made.write(topics.TICK, Tick(1))
    made.write(topics.TICK, Tick(-1))
    made.write(topics.TICK, Tick(2**63))
    made.write(topics.OBSERVED, ONE_OF_EACH[topics.REFERENCE])
    made.write(topics.LOG, LogLine(1, 256, "", ""))
    made.write(topics.TICK, Tick(2))
    assert made.close()
    (recording,) = recordings_in(tmp_path)
    assert list(recording.messages()) == [(topics.TICK, Tick(1)), (topics.TICK, Tick(2))]
    assert made.counters.refused == made.counters.dropped == 4
    assert made.counters.last_error.startswith("/log: ")


def test_lines_logged_by_whoever_provides_the_head_are_recorded_and_do_not_lock_up(tmp_path: Path) -> None:
    def head() -> Preamble:
        made.write(topics.LOG, LogLine(1, 20, "pipeline", "snapshot taken"))
        return HEAD

    made = Recorder(settings_for(tmp_path, rotate_mb=0.01), head)
    made.start()
    number, pause = 0, threading.Event()
    while made.counters.files < 2:
        made.write(topics.IMU_RAW, burst(number))
        number += 1
        pause.wait(0.0002)  # lets the writer thread keep up
    assert made.close()
    first, *_ = recordings_in(tmp_path)
    assert topics.LOG in {topic for topic, _ in first.messages()}


def test_a_failed_sync_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(descriptor: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fdatasync", broken)
    made = Recorder(settings_for(tmp_path, sync_interval_ms=1), lambda: HEAD)
    made.start()
    made.write(topics.TICK, Tick(1))
    assert made.close()
    assert made.counters.sync_errors >= 2  # folder and file
    assert made.counters.last_error == "fdatasync: Input/output error"
    assert made.counters.messages == 1


def test_flushes_go_on_while_a_sync_takes_its_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started, released = threading.Event(), threading.Event()

    def slow(descriptor: int) -> None:
        started.set()
        assert released.wait(PATIENCE_S)

    monkeypatch.setattr(os, "fdatasync", slow)
    made = Recorder(settings_for(tmp_path, sync_interval_ms=1), lambda: HEAD)
    made.start()
    assert started.wait(PATIENCE_S)
    for number in range(20):
        made.write(topics.IMU_RAW, burst(number))
        # Reaches the kernel although the disk is busy.
        wait_until(lambda: made.counters.messages == number + 1)  # noqa: B023 (called before the loop goes on)
    released.set()
    assert made.close(PATIENCE_S)
    (recording,) = recordings_in(tmp_path)
    assert len(list(recording.messages())) == 20


def test_a_hung_sync_keeps_few_descriptors_open(monkeypatch: pytest.MonkeyPatch) -> None:
    started, released, syncs = threading.Event(), threading.Event(), []

    def slow(descriptor: int) -> None:
        syncs.append(descriptor)
        started.set()
        assert released.wait(PATIENCE_S)

    monkeypatch.setattr(os, "fdatasync", slow)
    sync = background_sync.BackgroundSync(lambda error: None)
    read, write = os.pipe()
    sync.request(write)
    assert started.wait(PATIENCE_S)
    for _ in range(100):
        sync.request(write)
    assert not sync.close(0.01)
    released.set()
    sync._thread.join(PATIENCE_S)
    assert len(syncs) == 1 + 8
    os.close(read)
    os.close(write)


CHILD = """
import itertools, sys, time
from pathlib import Path
from daemon.recording import topics
from daemon.recording.metadata import Preamble
from daemon.recording.recorder import Recorder
from daemon.recording.settings import RecorderSettings
from drivers.adis16448.burst import Burst
from estimation.records import TimeKind

recorder = Recorder(
    RecorderSettings(directory=Path(sys.argv[1]), keep_free_mb=0), lambda: Preamble({"kind": "recording"})
)
recorder.start()
for number in itertools.count():
    words = (0, number & 0xFFFF, number >> 16, *range(9))
    recorder.write(topics.IMU_RAW, Burst(time.monotonic_ns(), TimeKind.EDGE, words, None))
    if recorder.counters.file:
        print(number, time.monotonic_ns(), flush=True)
    time.sleep(0.001)
"""


def reported(child: subprocess.Popen[str]) -> Iterator[tuple[int, int]]:
    """Number and time [ns] of each burst that the child handed to its recorder."""
    assert child.stdout is not None
    for line in child.stdout:
        if line.endswith("\n"):
            number, t_ns = line.split()
            yield int(number), int(t_ns)


@pytest.mark.parametrize("kill_at", [60, 277, 431, 640])
def test_a_killed_program_leaves_a_file_with_all_but_the_last_moment(kill_at: int, tmp_path: Path) -> None:
    command = [sys.executable, "-c", CHILD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        last, times = -1, {}
        for last, t_ns in reported(child):
            times[last] = t_ns
            if last == kill_at:
                child.kill()  # the rest of the pipe is still read
    assert last >= kill_at
    (recording,) = recordings_in(tmp_path)
    numbers = [number_of(record) for _, record in recording.messages()]
    assert numbers == list(range(len(numbers))), "a prefix, nothing missing in between"
    assert not recording.complete
    lost_s = (times[last] - times.get(len(numbers) - 1, min(times.values()))) / 1e9
    print(json.dumps({"killed_at": last, "kept": len(numbers), "lost_s": lost_s}))
    assert lost_s < 2, "generous: flushed every 0.1 s"
    report = recover(recording.path, tmp_path / "whole.mcap")
    assert (report.messages, report.lost) == (len(numbers), 0)
    assert passes_official_reader(tmp_path / "whole.mcap") == len(numbers)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"budget_mb": 100}, "budget_mb = 100 is smaller than one file"),
        ({"rotate_mb": 0}, "rotate_mb"),
        ({"flush_interval_ms": 20_000}, "less than or equal to 10000"),
        ({"flush": 5}, "Extra inputs are not permitted"),
    ],
)
def test_settings_that_make_no_sense_are_refused(changes: dict[str, float], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        RecorderSettings.model_validate(changes)


def test_the_description_says_who_wrote_the_file_and_which_clock_it_used() -> None:
    offset_ns = wall_offset_ns()
    described = describe("recording", '{"a": 1}', sensor="ADIS16448 4711", wall_minus_monotonic_ns=offset_ns)
    assert described["settings"] == '{"a": 1}'
    assert (described["kind"], described["sensor"]) == ("recording", "ADIS16448 4711")
    assert int(described["wall_minus_monotonic_ns"]) == offset_ns
    assert "wall_minus_monotonic_ns" not in describe("import", "{}")
