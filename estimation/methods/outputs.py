"""A batch method's course as the estimates and moves that every other part of the program takes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from estimation.blocks import SAMPLES_PER_STEP
from estimation.methods.batch import Batch, Course, Kind
from estimation.records import CanState, Estimate, Move, MoveKind, Output, Segment, Tier

STANDS_S = 1.0  # after the start of deceleration
UNKNOWN = float("nan")
_SEGMENT = {Kind.ZUPT: Segment.ZUPT, Kind.VVS: Segment.VVS, Kind.CVS: Segment.CVS}


def outputs_of(batch: Batch, course: Course) -> Iterator[Output]:
    """An estimate for every eighth sample, then the moves. These methods state no sigma: it is NaN."""
    t_ns = batch.first_ns + np.rint(batch.t_s * 1e9).astype(np.int64)
    begun = np.searchsorted([move.onset_s for move in course.moves], batch.t_s, side="right")
    lower, upper = course.limits_m_s2
    for i in range(SAMPLES_PER_STEP - 1, len(batch.t_s), SAMPLES_PER_STEP):
        yield Estimate(
            t_ns=int(t_ns[i]),
            displacement_m=float(course.displacement_m[i]),
            sigma_m=UNKNOWN,
            velocity_m_s=float(course.velocity_m_s[i]),
            velocity_sigma_m_s=UNKNOWN,
            segment=_SEGMENT[Kind(int(course.kind[i]))],
            tier=Tier.SETTLED,
            can_state=CanState.OK if len(batch.seen_s) else CanState.ABSENT,
            move=int(begun[i]),
            acceleration_m_s2=float(course.acceleration_m_s2[i]),
            chart_lower_m_s2=lower,
            chart_upper_m_s2=upper,
            step_m_s=UNKNOWN,
            innovation_m=UNKNOWN,
            gate_m=UNKNOWN,
        )
    for number, move in enumerate(course.moves, 1):
        start, end = (
            float(np.interp(at_s, batch.t_s, course.displacement_m)) for at_s in (move.onset_s, move.stop_s + STANDS_S)
        )
        even = (batch.t_s > move.onset_s + STANDS_S) & (batch.t_s < move.stop_s)
        yield Move(
            number=number,
            kind=MoveKind.PUSH if move.direction > 0 else MoveKind.RETRACT,
            onset_ns=batch.first_ns + round(move.onset_s * 1e9),
            stop_ns=batch.first_ns + round(move.stop_s * 1e9),
            start_m=start,
            end_m=end,
            sigma_m=UNKNOWN,
            end_before_stop_m=end,
            sigma_before_stop_m=UNKNOWN,
            velocity_m_s=float(course.velocity_m_s[even].mean()) if even.any() else UNKNOWN,
            can_state=CanState.OK if len(batch.seen_s) else CanState.ABSENT,
            tier=Tier.SETTLED,
        )
