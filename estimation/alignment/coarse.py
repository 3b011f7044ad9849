"""Coarse alignment from gravity and the Earth's rate as a resting sensor feels them (paper B, eq. 23-25)."""

from __future__ import annotations

import numpy as np

from estimation.alignment.earth import Place
from estimation.arrays import FloatArray


def triad(force: FloatArray, rate: FloatArray) -> FloatArray:
    """C_b^n (..., 3, 3) from mean specific force and mean rate (..., 3) in body axes.

    Up is where the force points, whatever the gyroscopes say; east is across it and the rate. So the level is as good
    as the accelerometers, and only the heading suffers from the gyroscopes.
    """
    up = _unit(force)
    across = np.cross(rate, up)
    # A rate of exactly zero, or straight up, names no east: the body's y axis then counts as north.
    nowhere = np.linalg.norm(across, axis=-1, keepdims=True) == 0.0
    east = _unit(np.where(nowhere, np.cross([0.0, 1.0, 0.0], up), across))
    return np.stack([east, np.cross(up, east), up], axis=-2)


def as_printed(force: FloatArray, rate: FloatArray, place: Place) -> FloatArray:
    """Eq. (25): the inverse of [g; w; g x w] in east-north-up times the same in body axes; no rotation in general."""
    g, w = np.array([0.0, 0.0, -place.gravity_m_s2]), place.rate
    known = np.stack([g, w, np.cross(g, w)])
    felt = np.stack([-force, rate, np.cross(-force, rate)], axis=-2)
    return np.asarray(np.linalg.inv(known) @ felt)


def nearest_rotation(c: FloatArray) -> FloatArray:
    """The rotation nearest to (..., 3, 3) by singular values: it spreads the gyroscopes' error into the level."""
    u, _, v = np.linalg.svd(c)
    return np.asarray(u @ v)


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))
