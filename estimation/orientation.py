"""Quaternion orientation of the sensor: paper C, eq. (4)-(8) and (10).

q is a Hamilton quaternion (w, x, y, z) that carries sensor vectors into the level frame, z up. In this convention
(4), (5), (7) and (10) of the paper agree with each other, and the correction is conj(dq) (x) q instead of the
printed (8), which holds for the opposite convention only. Heading is not observed; it stays where it started.
"""

from __future__ import annotations

from math import acos, cos, sin, sqrt

from estimation.records import Vector

Quaternion = tuple[float, float, float, float]
Matrix = tuple[Vector, Vector, Vector]
IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a (x) b."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def normalised(q: Quaternion) -> Quaternion:
    """Unit quaternion of the same direction."""
    w, x, y, z = q
    scale = 1.0 / sqrt(w * w + x * x + y * y + z * z)
    return (w * scale, x * scale, y * scale, z * scale)


def matrix(q: Quaternion) -> Matrix:
    """Rotation matrix R(q), paper C, eq. (7)."""
    w, x, y, z = q
    return (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )


def rotated(q: Quaternion, v: Vector) -> Vector:
    """R(q) v."""
    a, b, c = matrix(q)
    x, y, z = v
    return (
        a[0] * x + a[1] * y + a[2] * z,
        b[0] * x + b[1] * y + b[2] * z,
        c[0] * x + c[1] * y + c[2] * z,
    )


def propagated(q: Quaternion, gyro: Vector, dt_s: float) -> Quaternion:
    """Turn by the rate [rad/s] over dt: paper C, eq. (4), as the exact rotation of a constant rate."""
    gx, gy, gz = gyro
    rate = sqrt(gx * gx + gy * gy + gz * gz)
    half = 0.5 * rate * dt_s
    # sin(half)/rate without a division by zero
    scale = 0.5 * dt_s if half < 1e-9 else sin(half) / rate
    return normalised(multiply(q, (cos(half), gx * scale, gy * scale, gz * scale)))


def gravity_deviation(up: Vector) -> Quaternion:
    """Shortest rotation dq with R(dq) [0, 0, 1] = up (unit vector): paper C, eq. (6).

    Straight down has no shortest rotation; half a turn about x is taken.
    """
    ux, uy, uz = up
    if uz < -1.0 + 1e-12:
        return (0.0, 1.0, 0.0, 0.0)
    w = sqrt((1.0 + uz) / 2.0)
    return (w, -uy / (2.0 * w), ux / (2.0 * w), 0.0)


def shrunk(q: Quaternion, gain: float) -> Quaternion:
    """SLERP from the identity towards q by `gain` in [0, 1]."""
    w, x, y, z = q
    angle = acos(max(-1.0, min(1.0, w)))
    if angle < 1e-6:
        return normalised((1.0, gain * x, gain * y, gain * z))
    scale = sin(gain * angle) / sin(angle)
    return (cos(gain * angle), scale * x, scale * y, scale * z)


def corrected(q: Quaternion, accel: Vector, gain: float) -> Quaternion:
    """Turn q towards agreement with gravity as felt at rest: paper C, eq. (5), (6), (8).

    `gain` = 1 levels at once; a free-falling reading (zero vector) corrects nothing.
    """
    gx, gy, gz = rotated(q, accel)
    norm = sqrt(gx * gx + gy * gy + gz * gz)
    if norm == 0.0:
        return q
    w, x, y, z = shrunk(gravity_deviation((gx / norm, gy / norm, gz / norm)), gain)
    return normalised(multiply((w, -x, -y, -z), q))
