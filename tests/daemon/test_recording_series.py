"""Files of a recorder: names, cutting by size and time, the disk budget, and going on after errors."""

from __future__ import annotations

import errno
import logging
import os
import time
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any, BinaryIO

import pytest

from daemon.recording import metadata, retention, series, topics
from daemon.recording.metadata import Preamble
from daemon.recording.reader import Recording
from daemon.recording.series import FileSeries
from daemon.recording.settings import RecorderSettings
from daemon.recording.topics import TOPICS
from drivers.clock import VirtualClock
from tests.daemon.recording_kit import ATTACHMENTS, METADATA, SmallDisk, burst, number_of

HEAD = Preamble(METADATA, ATTACHMENTS)
IMU = list(TOPICS).index(topics.IMU_RAW) + 1


class Rig:
    """A series on a virtual clock with a disk that a test can fill, break and repair."""

    def __init__(self, directory: Path, **changes: Any) -> None:
        self.directory = directory
        self.clock = VirtualClock(0)
        self.free = 10**12
        self.synced: list[int] = []
        self.disk = SmallDisk(10**9)
        settings = RecorderSettings(directory=directory, **{"keep_free_mb": 0, **changes})
        self.series = FileSeries(
            settings,
            self.clock,
            self.synced.append,
            open_file=self.open_file,
            free_bytes=lambda path: self.free,
        )
        self.number = 0

    def open_file(self, path: Path) -> BinaryIO:
        return self.disk.open(path)

    def add(self, count: int = 1) -> None:
        for _ in range(count):
            record = burst(self.number)
            self.series.add(IMU, record.t_ns, self.number, TOPICS[topics.IMU_RAW].encode(record))
            self.number += 1

    def files(self) -> list[Path]:
        return retention.recordings(self.directory)

    def numbers(self, path: Path) -> list[int]:
        return [number_of(record) for _, record in Recording(path).messages()]


def test_a_new_file_is_wanted_when_the_size_is_reached_and_not_before(tmp_path: Path) -> None:
    rig = Rig(tmp_path, rotate_mb=0.02)
    rig.series.begin(HEAD)
    while not rig.series.wants_file:
        size = rig.files()[0].stat().st_size
        assert size < 20_000
        rig.add(20)
        rig.series.flush()
    assert rig.files()[0].stat().st_size >= 20_000
    kept = rig.number
    rig.series.begin(HEAD)
    assert not rig.series.wants_file
    rig.add(1)
    rig.series.close()
    first, second = rig.files()
    assert (rig.numbers(first), rig.numbers(second)) == (list(range(kept)), [kept])
    assert Recording(first).complete
    assert Recording(second).complete
    assert rig.series.counters.files == 2


def test_a_new_file_is_wanted_when_the_time_is_over(tmp_path: Path) -> None:
    rig = Rig(tmp_path, rotate_minutes=2)
    rig.series.begin(HEAD)
    rig.clock.sleep(119)
    rig.series.flush()
    assert not rig.series.wants_file
    rig.clock.sleep(1)
    rig.series.flush()
    assert rig.series.wants_file
    rig.series.begin(HEAD)
    rig.series.flush()
    assert not rig.series.wants_file
    rig.series.close()


def test_data_is_synced_once_per_interval_and_at_the_end(tmp_path: Path) -> None:
    rig = Rig(tmp_path, sync_interval_ms=1000)
    rig.series.begin(HEAD)
    assert len(rig.synced) == 1  # the folder, so that the name survives
    for _ in range(25):
        rig.clock.sleep(0.1)
        rig.add()
        rig.series.flush()
    assert len(rig.synced) == 3
    rig.series.close()
    assert len(rig.synced) == 4


def test_names_are_utc_and_never_taken_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: 1_700_000_000_999_999_999)
    rig = Rig(tmp_path)
    for _ in range(12):
        rig.series.begin(HEAD)
        rig.add()
    rig.series.close()
    stem = "ramstroke-20231114T221320Z"
    assert [path.name for path in rig.files()] == [
        f"{stem}.mcap",
        *(f"{stem}-{n}.mcap" for n in range(1, 12)),
    ]
    assert [rig.numbers(path) for path in rig.files()] == [[n] for n in range(12)]


def make_files(directory: Path, *sizes: int) -> list[Path]:
    paths = [directory / f"ramstroke-2024010{day}T000000Z.mcap" for day in range(1, len(sizes) + 1)]
    for path, size in zip(paths, sizes, strict=True):
        path.write_bytes(bytes(size))
    return paths


def test_the_oldest_files_go_first_and_only_as_many_as_needed(tmp_path: Path) -> None:
    paths = make_files(tmp_path, 100, 100, 100, 100)
    assert retention.make_room(tmp_path, 400, 0, None) == []
    assert retention.make_room(tmp_path, 399, 0, None) == paths[:1]
    assert retention.make_room(tmp_path, 150, 0, None) == paths[1:3]
    assert retention.recordings(tmp_path) == paths[3:]


def test_marked_files_the_file_being_written_and_strangers_stay_but_ours_count(tmp_path: Path) -> None:
    paths = make_files(tmp_path, 100, 100, 100, 100)
    (tmp_path / (paths[0].name + ".keep")).touch()
    stranger = tmp_path / "holiday.mcap"
    stranger.write_bytes(bytes(1000))
    assert retention.make_room(tmp_path, 300, 0, paths[1]) == [paths[2]]
    assert retention.make_room(tmp_path, 0, 0, paths[1]) == [paths[3]]
    assert retention.recordings(tmp_path) == paths[:2]
    assert stranger.exists()


def test_files_go_while_the_disk_has_less_free_than_it_should(tmp_path: Path) -> None:
    paths = make_files(tmp_path, 100, 100, 100)
    assert retention.make_room(tmp_path, 1000, 200, None, lambda path: 200) == []
    assert retention.make_room(tmp_path, 1000, 200, None, lambda path: 50) == paths[:2]


def test_nothing_is_sacrificed_to_a_disk_that_somebody_else_fills(tmp_path: Path) -> None:
    paths = make_files(tmp_path, 100, 100, 100)
    (tmp_path / (paths[2].name + ".keep")).touch()
    assert retention.make_room(tmp_path, 1000, 201, None, lambda path: 0) == []
    assert retention.make_room(tmp_path, 250, 201, None, lambda path: 0) == paths[:1], "the budget still holds"


def test_a_file_that_somebody_else_deletes_meanwhile_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = make_files(tmp_path, 100, 100)
    ghost = tmp_path / "ramstroke-20230101T000000Z.mcap"
    monkeypatch.setattr(retention, "recordings", lambda directory: [ghost, *paths])
    assert retention.make_room(tmp_path, 100, 0, None) == paths[:1]


def test_the_budget_is_kept_while_recording(tmp_path: Path) -> None:
    old = make_files(tmp_path, 30_000, 30_000)
    rig = Rig(tmp_path, rotate_mb=0.05, budget_mb=0.05)
    rig.series.begin(HEAD)
    assert not old[0].exists()
    assert old[1].exists()
    while old[1].exists():
        rig.add(20)
        rig.clock.sleep(1)
        rig.series.flush()
    assert sum(path.stat().st_size for path in rig.files()) <= 50_000
    assert rig.series.counters.deleted_files == 2
    rig.series.close()


def test_too_little_free_space_stops_recording_cleanly_until_there_is_more(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rig = Rig(tmp_path, keep_free_mb=200)
    rig.series.begin(HEAD)
    rig.add(5)
    rig.free = 199_000_000
    rig.clock.sleep(1)
    rig.series.flush()
    (path,) = rig.files()
    assert Recording(path).complete
    rig.add(3)
    assert rig.series.counters.dropped_no_disk == 3
    assert "keep_free_mb = 200 MB" in rig.series.counters.last_error
    rig.series.flush()
    assert not rig.series.wants_file, "asked again only after a second"
    rig.clock.sleep(1)
    rig.series.flush()
    assert rig.series.wants_file
    rig.series.begin(HEAD)
    rig.series.flush()
    assert not rig.series.wants_file
    assert rig.files() == [path]
    rig.free = 200_000_000
    rig.clock.sleep(1)
    rig.series.flush()
    rig.series.begin(HEAD)
    rig.add(1)
    rig.series.close()
    assert [rig.numbers(path) for path in rig.files()] == [[0, 1, 2, 3, 4], [8]]
    words = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert len(words) == 2, "said once, however often it was tried"
    assert "3 messages were lost" in words[1]


@pytest.mark.parametrize("room", [0, 100, 9_000, 9_500, 10_500, 14_000])
def test_a_full_disk_at_any_moment_leaves_whole_chunks_and_an_honest_count(room: int, tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.disk.room = room
    rig.series.begin(HEAD)
    for _ in range(20):
        rig.add(20)
        rig.series.flush()
    rig.series.close()
    counters = rig.series.counters
    assert counters.errors >= 1
    assert counters.messages + counters.dropped == rig.number == 400
    found = [rig.numbers(path) for path in rig.files()]
    assert found == ([list(range(counters.messages))] if counters.messages else []), "no empty files stay"
    for path in rig.files():
        assert Recording(path).damage == [
            "the index at the end is missing: the file was cut, damaged, or not yet finished"
        ]


def test_a_chunk_that_fills_up_between_two_flushes_can_fail_too(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.series.begin(HEAD)
    rig.add(5)
    rig.series.flush()
    rig.disk.room = 1000
    rig.add(5000)
    assert rig.series.counters.errors == 1
    assert rig.series.counters.dropped_no_disk == 5000
    (path,) = rig.files()
    assert rig.numbers(path) == list(range(5))


def test_an_index_that_does_not_fit_costs_no_message(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.series.begin(HEAD)
    rig.add(50)
    rig.series.flush()
    rig.disk.room = 10
    rig.series.close()
    (path,) = rig.files()
    assert rig.numbers(path) == list(range(50))
    assert (rig.series.counters.errors, rig.series.counters.dropped) == (1, 0)


def test_a_read_only_disk_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(tmp_path)
    monkeypatch.setattr(rig, "disk", None)

    def read_only(path: Path) -> BinaryIO:
        raise OSError(errno.EROFS, "Read-only file system")

    rig.series._open_file = read_only
    rig.series.begin(HEAD)
    rig.add(4)
    assert rig.series.counters.last_error == f"cannot write to {tmp_path}: Read-only file system"
    rig.series._open_file = series.open_new
    rig.clock.sleep(1)
    rig.series.flush()
    assert rig.series.wants_file
    rig.series.begin(HEAD)
    rig.add(4)
    rig.series.close()
    assert [rig.numbers(path) for path in rig.files()] == [[4, 5, 6, 7]]
    assert rig.series.counters.dropped == 4


def test_a_file_deleted_under_the_recorder_is_noticed_within_a_sync(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.series.begin(HEAD)
    rig.add(3)
    rig.series.flush()
    rig.files()[0].unlink()
    rig.clock.sleep(1)
    rig.series.flush()
    assert "was deleted while being written" in rig.series.counters.last_error
    rig.clock.sleep(1)
    rig.series.flush()
    assert rig.series.wants_file


def test_an_old_file_that_cannot_be_deleted_does_not_stop_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_files(tmp_path, 100_000)
    monkeypatch.setattr(os, "unlink", lambda *args, **options: (_ for _ in ()).throw(PermissionError(1, "no")))
    rig = Rig(tmp_path, rotate_mb=0.05, budget_mb=0.05)
    rig.series.begin(HEAD)
    rig.add(3)
    assert "cannot delete old recordings" in rig.series.counters.last_error
    rig.series.close()
    assert rig.series.counters.messages == 3
    assert rig.series.counters.errors == 1


def test_a_program_that_is_not_installed_has_no_version(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(name: str) -> str:
        raise PackageNotFoundError

    monkeypatch.setattr(metadata, "version", unknown)
    assert metadata.program_version.__wrapped__() == "unknown"


def test_the_free_space_is_that_of_the_disk(tmp_path: Path) -> None:
    assert 0 < retention.free_bytes(tmp_path) <= os.statvfs(tmp_path).f_blocks * os.statvfs(tmp_path).f_frsize


def test_a_disk_that_turned_read_only_is_known_from_the_sync_alone(tmp_path: Path) -> None:
    """After an error of the disk the kernel takes writes that it never writes down."""
    rig = Rig(tmp_path)
    rig.series.begin(HEAD)
    rig.add(5)
    rig.series.flush()
    rig.series.sync_failed(OSError(errno.EIO, "Input/output error"))
    rig.series.flush()
    assert rig.series.counters.file
    rig.series.sync_failed(OSError(errno.EROFS, "Read-only file system"))
    rig.add(3)
    rig.series.flush()
    counters = rig.series.counters
    assert (counters.file, counters.sync_errors, counters.dropped_no_disk) == ("", 2, 3)
    assert counters.last_error == f"cannot write to {tmp_path}: Read-only file system"
    assert rig.numbers(rig.files()[0]) == [0, 1, 2, 3, 4]
    rig.series.begin(HEAD)
    assert counters.file
