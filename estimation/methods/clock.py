"""The stop-watch: nominal speed times duration. What an estimator must beat."""

from __future__ import annotations

import numpy as np

from estimation.methods.batch import Batch, Course, kinds_of
from estimation.methods.integrate import integral


def clock(batch: Batch) -> Course:
    """At nominal speed from each onset to each stop, as this program's recogniser found them."""
    velocity = np.zeros(len(batch.t_s))
    for move in batch.moves:
        velocity[(batch.t_s >= move.onset_s) & (batch.t_s < move.stop_s)] = batch.nominal_speed(move.direction)
    displacement = batch.start_m + integral(velocity, batch.t_s)
    kind = kinds_of(batch.t_s, batch.moves, 0.0, 0.0)
    return Course(displacement, velocity, np.zeros(len(batch.t_s)), kind, batch.moves)
