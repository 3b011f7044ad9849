"""Strapdown navigation in east-north-up (paper B, eq. 12-20): attitude, velocity, position from increments.

Eq. (19) and (20) as printed carry signs of north-east-down; what is here follows from eq. (18), which is sound:

    v' = f^n - (2 w_ie + w_en) x v - g up

Rotation and velocity increments of successive intervals correct each other for coning and sculling to second order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import degrees, radians, tan

import numpy as np

from estimation.alignment.attitude import cross, rotation
from estimation.alignment.earth import Place
from estimation.arrays import FloatArray


@dataclass
class Strapdown:
    """Attitude C_b^n (..., 3, 3), velocity (..., 3) east, north, up, and one place for all."""

    place: Place
    attitude: FloatArray
    velocity: FloatArray
    longitude_deg: float = 0.0
    moves_place: bool = True  # not while aligning: who rests stays where he is
    holds_height: bool = False  # no vertical channel: its error grows without bound
    _before: tuple[FloatArray, FloatArray] | None = field(default=None, repr=False)

    def step(self, turn: FloatArray, push: FloatArray, dt_s: float) -> None:
        """Go on by increments (..., 3) of rotation [rad] and of velocity [m/s] in body axes."""
        coned = turn
        sculled = push + 0.5 * cross(turn, push)
        if self._before is not None:
            turn_before, push_before = self._before
            coned = turn + cross(turn_before, turn) / 12
            sculled = sculled + (cross(turn_before, push) + cross(push_before, turn)) / 12
        self._before = turn, push
        v = self.velocity
        meridian, vertical = self.place.radii_m
        w_ie = self.place.rate
        w_en = np.stack(
            [-v[..., 1] / meridian, v[..., 0] / vertical, v[..., 0] * tan(self.place.latitude) / vertical], axis=-1
        )
        # Half of the frame's own turn belongs to the middle of the interval, where the increment was felt.
        felt = (rotation(-0.5 * (w_ie + w_en) * dt_s) @ self.attitude @ sculled[..., None])[..., 0]
        down = np.array([0.0, 0.0, -self.place.gravity_m_s2])
        change = felt + (down - cross(2 * w_ie + w_en, v)) * dt_s
        self.attitude = rotation(-(w_ie + w_en) * dt_s) @ self.attitude @ rotation(coned)
        self.velocity = v + change
        if self.holds_height:
            self.velocity[..., 2] = 0.0
        if self.moves_place:
            self._go(0.5 * (v + self.velocity), dt_s)

    def _go(self, v: FloatArray, dt_s: float) -> None:
        meridian, vertical = self.place.radii_m
        east, north, up = np.asarray(v, dtype=np.float64).reshape(3).tolist()
        latitude = self.place.latitude_deg + degrees(north / meridian) * dt_s
        cosine = np.cos(radians(0.5 * (latitude + self.place.latitude_deg)))
        self.longitude_deg += degrees(east / (vertical * float(cosine))) * dt_s
        self.place = Place(latitude, self.place.height_m + up * dt_s)
