"""Samples in SI units out of what inertial sensors bring."""

from __future__ import annotations

from daemon.imu.roles import Role, is_jy901
from daemon.recording.topics import Inertial
from daemon.settings import Settings
from drivers.adis16448.burst import Burst, BurstDecoder, Fault
from drivers.adis16448.identity import Identity
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.reading import Reading
from estimation.records import ImuSample

# Beyond any inertial sensor (rad/s, m/s^2); only a damaged file or table holds more.
_LARGEST_READING = 1e4


class SampleDecoder:
    """Knows which records are the sensor of one role, and which of its samples are good."""

    def __init__(self, settings: Settings, role: Role = "main") -> None:
        self.is_jy901 = is_jy901(settings, role)
        self._bursts = BurstDecoder(settings.imu.gyro_range_dps)

    def is_mine(self, record: object) -> bool:
        """Whether it comes from this sensor, a bad sample and an identity too."""
        return isinstance(record, Reading | Jy901Identity if self.is_jy901 else Burst | Identity | ImuSample)

    def sample(self, record: Inertial) -> ImuSample | None:
        """The sample of one of its records; None if it is bad, or an identity."""
        if isinstance(record, Burst):
            return self._bursts.sample(record) if record.fault is Fault.NONE else None
        if isinstance(record, Reading):
            return None if record.is_frozen else record.sample()
        if isinstance(record, ImuSample):
            return record if is_possible(record) else None
        return None


def is_possible(sample: ImuSample) -> bool:
    """Whether any inertial sensor could have felt this."""
    return all(abs(value) < _LARGEST_READING for value in sample.gyro + sample.accel)
