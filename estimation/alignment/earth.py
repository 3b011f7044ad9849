"""The Earth as an inertial sensor at rest feels it: WGS 84 radii, Somigliana's gravity, rotation."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, radians, sin, sqrt

import numpy as np

from estimation.arrays import FloatArray

RATE_RAD_S = 7.292115e-5
MAJOR_M, FLATTENING = 6378137.0, 1 / 298.257223563
ECCENTRICITY_2 = FLATTENING * (2 - FLATTENING)
EQUATOR_M_S2, POLE_M_S2 = 9.7803253359, 9.8321849378
MINOR_M = MAJOR_M * (1 - FLATTENING)
SOMIGLIANA = MINOR_M * POLE_M_S2 / (MAJOR_M * EQUATOR_M_S2) - 1
M = RATE_RAD_S**2 * MAJOR_M**2 * MINOR_M / 3.986004418e14  # centrifugal to gravitational, for the height's term


@dataclass(frozen=True)
class Place:
    """A point on the Earth. Raises ValueError for a latitude beyond a pole, or at one, where east is undefined."""

    latitude_deg: float
    height_m: float = 0.0

    def __post_init__(self) -> None:
        if not abs(self.latitude_deg) < 89.9:
            raise ValueError(f"latitude {self.latitude_deg:g} deg: it must lie within 89.9 deg of the equator")
        if not -12_000 <= self.height_m <= 100_000:
            raise ValueError(f"height {self.height_m:g} m: it must lie between -12,000 and 100,000 m")

    @property
    def latitude(self) -> float:
        """In radians."""
        return radians(self.latitude_deg)

    @property
    def gravity_m_s2(self) -> float:
        """Somigliana's formula, with the height's second order; depth counts as negative height."""
        s2 = sin(self.latitude) ** 2
        at_sea = EQUATOR_M_S2 * (1 + SOMIGLIANA * s2) / sqrt(1 - ECCENTRICITY_2 * s2)
        h = self.height_m / MAJOR_M
        return at_sea * (1 - 2 * h * (1 + FLATTENING + M - 2 * FLATTENING * s2) + 3 * h * h)

    @property
    def rate_north_up(self) -> tuple[float, float]:
        """Components of the Earth's rate to the north and up [rad/s]; paper B, w_ie^n."""
        return RATE_RAD_S * cos(self.latitude), RATE_RAD_S * sin(self.latitude)

    @property
    def rate(self) -> FloatArray:
        """(3,) east, north, up [rad/s]."""
        return np.array([0.0, *self.rate_north_up])

    @property
    def radii_m(self) -> tuple[float, float]:
        """Meridian and prime vertical radius at this height."""
        root = sqrt(1 - ECCENTRICITY_2 * sin(self.latitude) ** 2)
        return MAJOR_M * (1 - ECCENTRICITY_2) / root**3 + self.height_m, MAJOR_M / root + self.height_m

    @property
    def mean_radius_m(self) -> float:
        """For the slow terms of an error model."""
        meridian, vertical = self.radii_m
        return hypot(meridian, vertical) / sqrt(2)
