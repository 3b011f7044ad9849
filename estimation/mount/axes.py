"""Sensor axes to support axes: x across, y along the push, z up."""

from __future__ import annotations

from estimation.records import Vector
from estimation.settings import MountSettings, SignedAxis

_INDEX = {"x": 0, "y": 1, "z": 2}


def _unit(axis: SignedAxis) -> Vector:
    unit = [0.0, 0.0, 0.0]
    unit[_INDEX[axis[1]]] = 1.0 if axis[0] == "+" else -1.0
    return (unit[0], unit[1], unit[2])


class Mount:
    """A signed permutation, so that it costs three look-ups a vector and never rounds."""

    def __init__(self, settings: MountSettings) -> None:
        y, z = _unit(settings.push), _unit(settings.up)
        x = (
            y[1] * z[2] - y[2] * z[1],
            y[2] * z[0] - y[0] * z[2],
            y[0] * z[1] - y[1] * z[0],
        )  # right-handed: x = y cross z
        self._picks = tuple((index, component) for row in (x, y, z) for index, component in enumerate(row) if component)

    def to_support(self, v: Vector) -> Vector:
        """A sensor vector in support axes."""
        (i, a), (j, b), (k, c) = self._picks
        return (a * v[i], b * v[j], c * v[k])
