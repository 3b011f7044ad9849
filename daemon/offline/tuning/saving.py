"""Where tuned values come from, for the configuration file that gets them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any

from daemon.offline import edited_configuration
from daemon.offline.tuning.recordings import fingerprint
from daemon.recording.metadata import program_version
from daemon.settings import Settings

MARK = "tuned by ramstroke tune"


def save(
    path: Path, values: dict[str, dict[str, Any]], settings: Settings, files: Sequence[Path], row: dict[str, Any]
) -> None:
    """Put the values (section -> key -> value) into the file, made from `settings` if there is none.

    Raises UsageError, or ConfigurationError where the file as it stands is none.
    """
    edited_configuration.save(path, values, settings, MARK, dict.fromkeys(values, _origin(files, row)))


def _origin(files: Sequence[Path], row: dict[str, Any]) -> str:
    """Where the values come from, for a comment."""
    ends = [row.get(f"log10_ratio_{end}") for end in ("low", "high")]
    known = [end for end in ends if end is not None and isfinite(end)]
    interval = f", log10(q/r) {known[0]:.2f} to {known[1]:.2f} (3 sigma)" if len(known) == 2 else ""
    if row.get("determined") is False:
        interval += ", NOT DETERMINED by these moves"
    return (
        f"{MARK} {program_version()}, {datetime.now(UTC):%Y-%m-%d}: method {row['method']}, objective "
        f"{row['objective']}, seed {row['seed']}, {row['evaluations']} evaluations{interval}; "
        f"{', '.join(file.name for file in files)} (SHA-256 {fingerprint(files)[:16]})"
    )
