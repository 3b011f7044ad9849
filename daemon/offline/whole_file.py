"""Results that appear whole or not at all: written beside, then renamed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from daemon.recording.errors import failed


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Where to write what becomes `path` at the end of the block; nothing is left if it ends with an exception.

    Raises RecordingError when the disk refuses.
    """
    part = path.with_name(f".{path.name}.part-{os.getpid()}")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        raise failed("write", path, error) from error
    finally:
        with suppress(OSError):
            part.unlink()
