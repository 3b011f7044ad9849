"""Pictures on disk, whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOTS_PER_INCH = 110


def save_picture(figure: Figure, path: Path) -> None:
    """Raises OSError, and ValueError for a format that nobody knows."""
    part = path.with_name(f".{path.stem}.part-{os.getpid()}{path.suffix}")  # the suffix is the format
    try:
        figure.savefig(part, dpi=DOTS_PER_INCH)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
