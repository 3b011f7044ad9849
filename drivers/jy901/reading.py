"""One sample of the JY901 as it came over the line, and in SI units."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.jy901.packets import ACCEL_LSB, GYRO_LSB, TEMPERATURE_LSB
from estimation.records import ImuSample, TimeKind

Words = tuple[int, int, int, int]


@dataclass(slots=True, frozen=True)
class Reading:
    """The words of an acceleration and of a rate packet, each with the temperature behind it."""

    t_ns: int
    accel: Words  # signed, 16 bits
    gyro: Words
    is_frozen: bool = False  # the part repeats itself longer than noise ever lets it

    def sample(self) -> ImuSample:
        """Specific force [m/s^2], rate [rad/s] and temperature [degC]."""
        ax, ay, az, temperature = self.accel
        gx, gy, gz, _ = self.gyro
        return ImuSample(
            self.t_ns,
            (gx * GYRO_LSB, gy * GYRO_LSB, gz * GYRO_LSB),
            (ax * ACCEL_LSB, ay * ACCEL_LSB, az * ACCEL_LSB),
            temperature * TEMPERATURE_LSB,
            TimeKind.READ,
        )
