"""Attitudes as matrices from body to east-north-up (paper B, C_b^n), one or many at once: (..., 3, 3)."""

from __future__ import annotations

import numpy as np

from estimation.arrays import FloatArray


def from_angles(pitch: FloatArray, roll: FloatArray, yaw: FloatArray) -> FloatArray:
    """C_b^n = Rz(yaw) Rx(pitch) Ry(roll), radians.

    Paper B calls the angle about x_b roll and that about y_b pitch; here they have the names that most texts give them:
    y_b runs along the face, so the angle about x_b is its pitch. Yaw is counter-clockwise from above.
    """
    (cp, sp), (ct, st), (cg, sg) = ((np.cos(one), np.sin(one)) for one in (yaw, pitch, roll))
    rows = [
        [cp * cg - sp * st * sg, -sp * ct, cp * sg + sp * st * cg],
        [sp * cg + cp * st * sg, cp * ct, sp * sg - cp * st * cg],
        [-ct * sg, st, ct * cg],
    ]
    return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=-2)


def to_angles(c: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pitch, roll, yaw of attitudes (..., 3, 3)."""
    return (
        np.arcsin(np.clip(c[..., 2, 1], -1.0, 1.0)),
        np.arctan2(-c[..., 2, 0], c[..., 2, 2]),
        np.arctan2(-c[..., 0, 1], c[..., 1, 1]),
    )


def cross_matrix(v: FloatArray) -> FloatArray:
    """[v x] of vectors (..., 3): (..., 3, 3)."""
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -z, y, -x
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = z, -y, x
    return matrix


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """a x b of vectors (..., 3); of one vector numpy's own takes four times as long."""
    (ax, ay, az), (bx, by, bz) = ((v[..., 0], v[..., 1], v[..., 2]) for v in (a, b))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def rotation(v: FloatArray) -> FloatArray:
    """Rotation by rotation vectors (..., 3), exact (Rodrigues)."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    sine = np.where(small, 1 - angle**2 / 6, np.sin(safe) / safe)
    cosine = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    k = cross_matrix(v)
    return np.asarray(np.eye(3) + sine * k + cosine * (k @ k))


def misalignment(computed: FloatArray, true: FloatArray) -> FloatArray:
    """phi (..., 3) east, north, up with computed = (I - [phi x]) true, small (paper B, eq. 29)."""
    error = computed @ np.swapaxes(true, -1, -2)
    skew = 0.5 * (error - np.swapaxes(error, -1, -2))
    return -np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)
