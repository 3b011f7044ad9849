"""Direct double integration of the acceleration, as the papers compare with: paper C, eq. (9)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.arrays import FloatArray
from estimation.methods.batch import Batch, Course, Kind, levelled_at_rest
from estimation.orientation import IDENTITY, corrected, rotated


def integral(values: FloatArray, t_s: FloatArray) -> FloatArray:
    """Running integral (n,) by trapezoids, zero at the first sample."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(t_s)
    return np.concatenate(([0.0], np.cumsum(steps)))


def integrate_levelled(batch: Batch) -> Course:
    """Less the level of the rest before each move; between moves nothing is known of the speed."""
    return _integrated(batch, levelled_at_rest(batch))


def integrate_raw(batch: Batch) -> Course:
    """Turned by gravity as first felt, and no more: what is left of tilt and bias is integrated, too."""
    first = batch.accel[batch.t_s < 1.0].mean(axis=0)
    q = corrected(IDENTITY, (float(first[0]), float(first[1]), float(first[2])), 1.0)
    to_push = np.array([rotated(q, unit)[1] for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))])
    return _integrated(batch, batch.accel @ to_push)


def _integrated(batch: Batch, acceleration: FloatArray) -> Course:
    velocity = integral(acceleration, batch.t_s)
    kind: NDArray[np.int8] = np.full(len(batch.t_s), Kind.VVS, dtype=np.int8)
    return Course(batch.start_m + integral(velocity, batch.t_s), velocity, acceleration, kind, batch.moves)
