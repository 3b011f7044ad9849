"""What a review can write: a report, tables, pictures."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from daemon.errors import UsageError
from daemon.offline.exports.csv_tables import csv_tables
from daemon.offline.exports.tables import TableExport, Writer, tables
from daemon.offline.progress import shares
from daemon.offline.replaying.replay import settings_of
from daemon.offline.report.collecting import Collector
from daemon.offline.report.document import Chapter, chapter, require_plotly, write_report
from daemon.offline.reviewing.onlooker import Onlooker
from daemon.offline.reviewing.review import Review, review
from daemon.recording.errors import RecordingError, refuse_same_file
from daemon.recording.reader import Recording
from estimation.methods.registry import OURS


@dataclass(slots=True, frozen=True)
class Wanted:
    """Where to write; None: not wanted. With several recordings each has a folder of its own in the folders."""

    report: Path | None = None
    csv: Path | None = None
    parquet: Path | None = None
    pictures: Path | None = None

    @property
    def folders(self) -> dict[str, Path]:
        """Option and folder."""
        named = {"--csv": self.csv, "--parquet": self.parquet, "--png": self.pictures}
        return {option: folder for option, folder in named.items() if folder is not None}


def review_to(
    paths: Sequence[Path],
    wanted: Wanted,
    method: str = OURS,
    others: Sequence[str] = (),
    progress: Callable[[float], None] | None = None,
) -> list[Review]:
    """Review each recording and write what is wanted, each file whole or not at all.

    Raises RecordingError, CanConfigError, or CommandError where something cannot be written.
    """
    _check(paths, wanted)
    reviewed: list[Review] = []
    chapters: list[Chapter] = []
    parts = shares(progress, *[1 / len(paths)] * len(paths))
    with _folders(wanted, _names(paths) if len(paths) > 1 else [""]) as places:
        for path, place, part in zip(paths, places, parts, strict=True):
            one, written = _review_one(path, place, method, others, part, with_report=wanted.report is not None)
            reviewed.append(one)
            chapters += written
        if wanted.report is not None:
            write_report(wanted.report, chapters)
    return reviewed


def _review_one(
    path: Path,
    places: Wanted,
    method: str,
    others: Sequence[str],
    progress: Callable[[float], None] | None,
    *,
    with_report: bool,
) -> tuple[Review, list[Chapter]]:
    settings = settings_of(Recording(path))
    onlookers: list[Onlooker] = []
    collector = Collector(settings)
    if with_report or places.pictures is not None:
        onlookers.append(collector)
    with ExitStack() as stack:
        exports: list[TableExport] = []
        smoothed = method == OURS
        for writer in _writers(stack, places, smoothed=smoothed):
            exports.append(TableExport(writer, settings, smoothed=smoothed))
        found = review(path, progress, [*onlookers, *exports], method, others)
        for export in exports:
            export.finish(found)
        if places.pictures is not None:
            from daemon.offline.exports.pictures import draw_pictures

            stroke_mm = found.replayed.settings.support.stroke_mm
            draw_pictures(places.pictures, path.stem, collector, found.replayed.moves, stroke_mm)
        return found, [chapter(path, found, collector)] if with_report else []


def _writers(stack: ExitStack, places: Wanted, *, smoothed: bool) -> Iterator[Writer]:
    made = tables(smoothed=smoothed)
    if places.csv is not None:
        yield stack.enter_context(csv_tables(places.csv, made))
    if places.parquet is not None:
        from daemon.offline.exports.parquet_tables import parquet_tables

        yield stack.enter_context(parquet_tables(places.parquet, made))


def _check(paths: Sequence[Path], wanted: Wanted) -> None:
    """What would fail after an hour of computing fails now."""
    if wanted.report is not None:
        for path in paths:
            refuse_same_file(path, wanted.report)
        folder = wanted.report.parent
        if wanted.report.is_dir():
            raise RecordingError(f"cannot write {wanted.report}: it is a folder; name a file, such as report.html")
        if not folder.is_dir():
            raise RecordingError(f"cannot write {wanted.report}: {folder} is no folder; make it, or name another place")
        if not os.access(folder, os.W_OK):
            raise RecordingError(f"cannot write {wanted.report}: no right to write in {folder}; name another place")
        require_plotly()
    if wanted.parquet is not None:
        from daemon.offline.exports.parquet_tables import require_pyarrow

        require_pyarrow()
    if wanted.pictures is not None:
        from daemon.offline.evaluation.plots import require_matplotlib

        require_matplotlib()
    for path in paths:
        Recording(path)  # a bad one among several is told before the others are read


@contextmanager
def _folders(wanted: Wanted, names: Sequence[str]) -> Iterator[list[Wanted]]:
    """Folders for each recording; those that stay empty are taken away again."""
    made: list[Path] = []
    try:
        for option, folder in wanted.folders.items():
            for name in names:
                made += _make(option, folder / name)
        yield [
            Wanted(
                csv=None if wanted.csv is None else wanted.csv / name,
                parquet=None if wanted.parquet is None else wanted.parquet / name,
                pictures=None if wanted.pictures is None else wanted.pictures / name,
            )
            for name in names
        ]
    finally:
        for folder in sorted(made, key=lambda path: len(path.parts), reverse=True):
            with suppress(OSError):
                folder.rmdir()


def _make(option: str, folder: Path) -> list[Path]:
    """The folders that were not there before."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{option} {folder}: {error.strerror}; name a folder that can be written") from None
    if not os.access(folder, os.W_OK):
        raise UsageError(f"{option} {folder}: no right to write there; name another folder")
    return missing


def _names(paths: Sequence[Path]) -> list[str]:
    """The recordings' names, with a number where two have the same."""
    names: list[str] = []
    for path in paths:
        name, number = path.stem, 1
        while name in names:
            number += 1
            name = f"{path.stem}-{number}"
        names.append(name)
    return names
