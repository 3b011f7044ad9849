"""What stands at the head of every recording besides the messages."""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Literal

METADATA_NAME = "ramstroke"
SNAPSHOT = "pipeline-snapshot.json"
LEARNED = "learned-state.json"
FORMAT = "1"

Kind = Literal["recording", "import"]


@dataclass(slots=True, frozen=True)
class Preamble:
    """Description of a file and the state of the program at its first record.

    metadata: text by key, see `describe`.
    attachments: JSON bytes by name, `SNAPSHOT` and `LEARNED` where there are any.
    """

    metadata: Mapping[str, str]
    attachments: Mapping[str, bytes] = field(default_factory=dict)


@cache
def program_version() -> str:
    """Version of the installed program."""
    try:
        return version("ramstroke")
    except PackageNotFoundError:
        return "unknown"


def wall_offset_ns() -> int:
    """Wall clock minus monotonic clock at this moment [ns]."""
    return time.time_ns() - time.monotonic_ns()


def describe(
    kind: Kind, settings_json: str, *, sensor: str = "", wall_minus_monotonic_ns: int | None = None
) -> dict[str, str]:
    """Metadata of a file.

    sensor: identity of the inertial sensor (product id, serial number), empty when unknown.
    wall_minus_monotonic_ns: see `wall_offset_ns`; None when the times of the file are of no known clock.
    """
    described = {
        "format": FORMAT,
        "program": "ramstroke",
        "version": program_version(),
        "kind": kind,
        "created": datetime.now(UTC).isoformat(),
        "machine": platform.machine(),
        "settings": settings_json,
        "sensor": sensor,
    }
    if wall_minus_monotonic_ns is not None:
        described["wall_minus_monotonic_ns"] = str(wall_minus_monotonic_ns)
    return described
