"""How the sensor sits, from a recording: the estimate beside the configuration, as plain data and in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daemon.inertial import SampleDecoder
from daemon.offline.replaying.replay import settings_of
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import RecordedDisplacement
from drivers.acquisition import AnyIdentity
from drivers.adis16448.burst import Burst
from drivers.adis16448.identity import Identity
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.reading import Reading
from estimation.mount.calibration import Axis, MountCalibration, MountEstimate, Verdict
from estimation.records import ImuSample, SensorChange
from estimation.settings import MountSettings

_INPUTS = (
    *(topics.IMU_IDENTITY, topics.IMU_RAW, topics.IMU_SAMPLE, topics.JY901_IDENTITY, topics.JY901),
    *(topics.OBSERVED, topics.REFERENCE),
)
OBLIQUE_DEG = 10.0  # takes 1.5 % off a burst: as much as the speed of one move scatters


@dataclass(slots=True, frozen=True)
class MountReview:
    """What a recording tells of the mount, and what it was made with."""

    estimate: MountEstimate
    configured: MountSettings

    @property
    def agrees(self) -> bool | None:
        """Whether the configuration names the measured axes; None if these are not determined."""
        push, up = self.estimate.push, self.estimate.up
        if self.estimate.verdict is not Verdict.DETERMINED or push is None or up is None:
            return None
        return (push.name, up.name) == (self.configured.push, self.configured.up)

    def row(self) -> dict[str, Any]:
        """All of it, for JSON."""
        found = self.estimate
        up, push = _axis_row("up", found.up), _axis_row("push", found.push)
        off_deg = None if found.up is None or found.push is None else max(found.up.off_deg, found.push.off_deg)
        return {
            "verdict": str(found.verdict),
            "why": found.why,
            **up,
            **push,
            "off_deg": off_deg,
            "bursts": found.bursts,
            "bursts_found": found.bursts_found,
            "chi_square": found.chi_square,
            "degrees_of_freedom": found.degrees_of_freedom,
            "sign_from": found.sign_from,
            "configured_push": self.configured.push,
            "configured_up": self.configured.up,
            "agrees": self.agrees,
        }

    def lines(self) -> list[str]:
        """A short paragraph, with the lines for the configuration file if they are known."""
        found = self.estimate
        said = [f"mount: {found.verdict}" + (f": {found.why}" if found.why else "")]
        if found.bursts:
            said.append(
                f"  {found.bursts} of {found.bursts_found} bursts used, chi-square of their agreement "
                f"{found.chi_square:.1f} of {found.degrees_of_freedom}"
            )
        said += [
            f"  {name:<4} = {_vector(axis)} ± {axis.sigma_deg:.1f}°, {axis.off_deg:.1f}° off {axis.name}"
            for name, axis in (("up", found.up), ("push", found.push))
            if axis is not None
        ]
        if found.sign_from:
            doubt = (
                ": wrong if [support] does not hold their true speeds" if found.sign_from == "nominal speeds" else ""
            )
            said.append(f"  pushes told from retracts by the {found.sign_from}{doubt}")
        if any(axis is not None and axis.off_deg > OBLIQUE_DEG for axis in (found.up, found.push)):
            said.append(f"  more than {OBLIQUE_DEG:.0f}° off shortens what the sensor feels: turn the sensor")
        if found.verdict is Verdict.DETERMINED and found.push is not None and found.up is not None:
            configured = self.configured
            made_with = f'push = "{configured.push}", up = "{configured.up}"'
            said += ["[mount]", f'push = "{found.push.name}"', f'up = "{found.up.name}"']
            said.append(
                "# as configured" if self.agrees else f"# NOT as configured: the recording was made with {made_with}"
            )
        return said


def review_mount(path: Path, progress: Callable[[float], None] | None = None) -> MountReview:
    """Read one recording. Raises RecordingError.

    progress: called now and then with the share of the file that has been read.
    """
    recording = Recording(path)
    settings = settings_of(recording)
    calibration = MountCalibration(settings.support, settings.mount.imu_on)
    decoder = SampleDecoder(settings)
    part: AnyIdentity | None = None
    for count, (_, record) in enumerate(recording.messages(_INPUTS), start=1):
        if isinstance(record, Burst | Reading | ImuSample):
            sample = decoder.sample(record) if decoder.is_mine(record) else None
            if sample is not None:
                calibration.feed(sample)
        elif isinstance(record, RecordedDisplacement):
            calibration.feed(record.reading)
        elif isinstance(record, Identity | Jy901Identity) and decoder.is_mine(record):
            if part is not None and not record.is_same_part(part):
                calibration.feed(SensorChange(record.t_ns))
            part = record
        if progress is not None and count % 5000 == 0:
            progress(recording.share_read)
    return MountReview(calibration.estimate(), settings.mount)


def _axis_row(name: str, axis: Axis | None) -> dict[str, Any]:
    return {
        name: None if axis is None else list(axis.direction),
        f"{name}_sigma_deg": None if axis is None else axis.sigma_deg,
        f"{name}_axis": None if axis is None else axis.name,
        f"{name}_off_deg": None if axis is None else axis.off_deg,
    }


def _vector(axis: Axis) -> str:
    return "[" + ", ".join(f"{value:+.3f}" for value in axis.direction) + "]"
