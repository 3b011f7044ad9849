"""Sensor axes to support axes: x across, y along the push, z up."""

from __future__ import annotations

from math import cos, radians, sin

from estimation.records import Vector
from estimation.settings import AxesSettings, SignedAxis

_INDEX = {"x": 0, "y": 1, "z": 2}


def _unit(axis: SignedAxis) -> Vector:
    unit = [0.0, 0.0, 0.0]
    unit[_INDEX[axis[1]]] = 1.0 if axis[0] == "+" else -1.0
    return (unit[0], unit[1], unit[2])


class Mount:
    """A signed permutation, so that it costs three look-ups a vector and never rounds; then the tilt, if there is one.

    The tilt is Rx(pitch) Ry(roll): the attitude of the tilted axes at heading 0 (paper B).
    """

    def __init__(self, settings: AxesSettings, *, with_tilt: bool = True) -> None:
        y, z = _unit(settings.push), _unit(settings.up)
        x = (
            y[1] * z[2] - y[2] * z[1],
            y[2] * z[0] - y[0] * z[2],
            y[0] * z[1] - y[1] * z[0],
        )  # right-handed: x = y cross z
        self._picks = tuple((index, component) for row in (x, y, z) for index, component in enumerate(row) if component)
        self._tilt: tuple[Vector, Vector, Vector] | None = None
        if with_tilt and (settings.pitch_deg or settings.roll_deg):
            st, ct = sin(radians(settings.pitch_deg)), cos(radians(settings.pitch_deg))
            sg, cg = sin(radians(settings.roll_deg)), cos(radians(settings.roll_deg))
            self._tilt = ((cg, 0.0, sg), (st * sg, ct, -st * cg), (-ct * sg, st, ct * cg))

    def to_support(self, v: Vector) -> Vector:
        """A sensor vector in support axes."""
        (i, a), (j, b), (k, c) = self._picks
        x, y, z = a * v[i], b * v[j], c * v[k]
        if self._tilt is None:
            return (x, y, z)
        p, q, r = self._tilt
        return (
            p[0] * x + p[1] * y + p[2] * z,
            q[0] * x + q[1] * y + q[2] * z,
            r[0] * x + r[1] * y + r[2] * z,
        )
