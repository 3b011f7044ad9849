"""The folder of recordings as a page may see it: what is listed, and nothing else."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path
from typing import Any

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*\.mcap")
SHOWN = 200  # newest first


def listed(directory: Path, current: str) -> list[dict[str, Any]]:
    """Name, bytes, time of the last change (wall clock) of each recording, newest first; `current` is being written."""
    rows: list[dict[str, Any]] = []
    try:
        entries = list(directory.iterdir())
    except OSError:
        return []
    for path in entries:
        if (found := _looked_at(directory, path.name)) is not None:
            rows.append({"name": path.name, "bytes": found.st_size, "changed_s": found.st_mtime})
    rows.sort(key=lambda row: row["changed_s"], reverse=True)
    for row in rows:
        row["growing"] = row["name"] == Path(current).name
    return rows[:SHOWN]


def named(directory: Path, name: str) -> Path | None:
    """The recording of that name, if it would be listed."""
    return directory / name if _looked_at(directory, name) is not None else None


def _looked_at(directory: Path, name: str) -> os.stat_result | None:
    """Its figures if it is a recording: a plain file of the folder, for links may lead anywhere."""
    if not _NAME.fullmatch(name):  # nor may a name: it comes from outside, slashes and all
        return None
    try:
        found = (directory / name).lstat()
    except OSError:
        return None
    return found if stat.S_ISREG(found.st_mode) else None
