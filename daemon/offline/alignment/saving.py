"""What an alignment found, into the configuration that `run` uses."""

from __future__ import annotations

from datetime import UTC, datetime
from math import degrees
from pathlib import Path
from typing import Any

from daemon.configuration import load
from daemon.errors import CommandError, UsageError
from daemon.imu.roles import Role
from daemon.offline import edited_configuration
from daemon.offline.alignment.align import Alignment
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

    Raises CommandError where a level may not be claimed; UsageError if the file describes another mount, or cannot be
    written; ConfigurationError where it is none.
    """
    if path.exists():
        _refuse_another_mount(path, load(path), settings)
    values = {_SECTION[role]: _tilt(role, alignment) for role, alignment in found.items()}
    heading = found["main"].angles[2]
    if heading_deg is not None:
        values["mount"]["heading_deg"] = heading_deg
    elif heading.verdict is Verdict.OBSERVED:
        values["mount"]["heading_deg"] = degrees(heading.value)
    origins = {
        _SECTION[role]: f"{MARK} {program_version()}, {datetime.now(UTC):%Y-%m-%d}: {alignment.rest_s:.0f} s of rest, "
        f"± {degrees(alignment.angles[0].sigma):.3f} deg; {recording.name}"
        for role, alignment in found.items()
    }
    edited_configuration.save(path, values, settings, MARK, origins)


def _refuse_another_mount(path: Path, target: Settings, made_with: Settings) -> None:
    """A tilt belongs to a sensor and to the axes that its recording was made with."""
    pairs: list[tuple[str, str, str]] = [("jy901.use", target.jy901.use, made_with.jy901.use)]
    for section in ("mount", *(["jy901_mount"] if made_with.jy901.use == "beside" else [])):
        for key in ("push", "up"):
            pairs.append((f"{section}.{key}", getattr(getattr(target, section), key), _axis(made_with, section, key)))
    for name, there, here in pairs:
        if there != here:
            raise UsageError(
                f'--save {path}: it has {name} = "{there}", the recording was made with "{here}": the tilt would be '
                "that of another mount"
            )


def _axis(settings: Settings, section: str, key: str) -> str:
    return str(getattr(getattr(settings, section), key))


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
