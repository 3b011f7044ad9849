"""What an alignment found, into the configuration that `run` uses."""

from __future__ import annotations

from datetime import UTC, datetime
from math import degrees
from pathlib import Path
from typing import Any

from daemon.errors import CommandError
from daemon.imu.roles import Role
from daemon.offline import edited_configuration
from daemon.offline.alignment import Alignment
from daemon.recording.metadata import program_version
from daemon.settings import Settings
from estimation.alignment.verdict import Verdict

MARK = "aligned by ramstroke align"
STEEPEST_DEG = 45.0  # that [mount] takes; a sensor tilted more has other axes
_SECTION: dict[Role, str] = {"main": "mount", "beside": "jy901_mount"}


def save(
    path: Path, recording: Path, settings: Settings, found: dict[Role, Alignment], heading_deg: float | None
) -> None:
    """Put tilts, and the heading if it is known, into the file, made from `settings` if there is none.

    Raises CommandError where a level may not be claimed; UsageError, or ConfigurationError, as the file is.
    """
    values = {_SECTION[role]: _tilt(role, alignment) for role, alignment in found.items()}
    heading = found["main"].angles[2]
    if heading_deg is not None:
        values["mount"]["heading_deg"] = heading_deg
    elif heading.verdict is Verdict.OBSERVED:
        values["mount"]["heading_deg"] = degrees(heading.value)
    origin = (
        f"{MARK} {program_version()}, {datetime.now(UTC):%Y-%m-%d}: {found['main'].rest_s:.0f} s of rest, "
        f"± {degrees(found['main'].angles[0].sigma):.3f} deg; {recording.name}"
    )
    edited_configuration.save(path, values, settings, MARK, origin)


def _tilt(role: Role, alignment: Alignment) -> dict[str, Any]:
    tilt = {}
    for angle in alignment.angles[:2]:
        if angle.verdict is not Verdict.OBSERVED:
            which = "" if role == "main" else " of the sensor beside"
            raise CommandError(
                f"not saved: the {angle.name}{which} is {angle.verdict}; name the right --grade"
                f"{'' if role == 'main' else ' with --beside-grade'}, or align on a longer rest"
            )
        if abs(degrees(angle.value)) > STEEPEST_DEG:
            raise CommandError(
                f"not saved: a {angle.name} of {degrees(angle.value):.0f} deg is no tilt but other axes: "
                "see push and up in [mount], or `ramstroke review FILE --estimate-mount`"
            )
        tilt[f"{angle.name}_deg"] = degrees(angle.value)
    return tilt
