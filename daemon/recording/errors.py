"""The error of a recording that cannot be read or written."""

from __future__ import annotations

from pathlib import Path


class RecordingError(Exception):
    """A recording cannot be used; the text is one sentence that names the file and what to do."""


def failed(action: str, path: Path, error: OSError) -> RecordingError:
    """`error` of the operating system in words: "cannot read x.mcap: Permission denied"."""
    return RecordingError(f"cannot {action} {path}: {error.strerror or error}")


def refuse_same_file(source: Path, target: Path) -> None:
    """Raise `RecordingError` when writing `target` would destroy `source`, whatever they are called."""
    if target.exists() and source.exists() and target.samefile(source):
        raise RecordingError(f"{target} is the file to read from: name another file for the result")
