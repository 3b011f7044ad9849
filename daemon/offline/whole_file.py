"""Results that appear whole or not at all: written beside, then renamed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from daemon.recording.errors import failed


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Where to write what becomes `path` at the end of the block; nothing is left if it ends with an exception.

    The name has the suffix of `path`, by which some programs choose the format. Raises OSError.
    """
    part = path.with_name(f".{path.stem}.part-{os.getpid()}{path.suffix}")
    try:
        yield part
        part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink()


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """As `replaced`. Raises RecordingError, which is a sentence, when the disk refuses."""
    try:
        with replaced(path) as part:
            yield part
    except OSError as error:
        raise failed("write", path, error) from error
