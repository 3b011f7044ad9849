"""Pictures on disk, whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from daemon.offline.whole_file import replaced

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOTS_PER_INCH = 110


def save_picture(figure: Figure, path: Path) -> None:
    """Raises OSError, and ValueError for a format that nobody knows."""
    with replaced(path) as part:
        figure.savefig(part, dpi=DOTS_PER_INCH)
