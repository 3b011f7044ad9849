"""Names of the recordings in a folder, and which of them go when the disk runs short."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

_NAME = re.compile(r"ramstroke-(\d{8}T\d{6}Z)(?:-(\d+))?\.mcap")
KEEP_SUFFIX = ".keep"


def names(wall_ns: int) -> Iterator[str]:
    """File names for a recording that begins at `wall_ns` (UTC): plain first, then with -1, -2, ..."""
    stem = f"ramstroke-{datetime.fromtimestamp(wall_ns // 1_000_000_000, UTC):%Y%m%dT%H%M%SZ}"
    yield f"{stem}.mcap"
    for suffix in count(1):
        yield f"{stem}-{suffix}.mcap"


def recordings(directory: Path) -> list[Path]:
    """Recordings in `directory`, oldest first by the time in the name; files named otherwise are not ours."""
    found = [(match, path) for path in directory.iterdir() if (match := _NAME.fullmatch(path.name))]
    found.sort(key=lambda item: (item[0][1], int(item[0][2] or 0)))
    return [path for _, path in found]


def free_bytes(directory: Path) -> int:
    """Bytes an ordinary user may still write to the disk of `directory`."""
    return shutil.disk_usage(directory).free


def make_room(
    directory: Path,
    budget_bytes: float,
    keep_free_bytes: float,
    current: Path | None,
    free: Callable[[Path], int] = free_bytes,
) -> list[Path]:
    """Delete the oldest recordings until the budget and the free space hold; returns the deleted ones.

    The file being written (`current`) and files marked by a sibling NAME.keep stay, but count. When even all
    of ours would not free enough, somebody else fills the disk and nothing is sacrificed to that.
    Raises `OSError` when the folder cannot be read or a file cannot be deleted.
    """
    total = 0
    deletable: dict[Path, int] = {}
    for path in recordings(directory):
        with suppress(FileNotFoundError):  # somebody else tidied up
            size = path.stat().st_size
            total += size
            if path != current and not path.with_name(path.name + KEEP_SUFFIX).exists():
                deletable[path] = size
    short_of_free = keep_free_bytes - free(directory)
    surplus = total - budget_bytes
    if short_of_free <= sum(deletable.values()):
        surplus = max(surplus, short_of_free)
    deleted: list[Path] = []
    for path, size in deletable.items():
        if surplus <= 0:
            break
        path.unlink(missing_ok=True)
        deleted.append(path)
        surplus -= size
    return deleted
