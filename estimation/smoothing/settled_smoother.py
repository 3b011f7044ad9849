"""The settled track, smoothed: at each step what all of the recording says, not only what came before."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from estimation.mskf import SPEED, P, V
from estimation.pipeline import Pipeline
from estimation.records import Estimate
from estimation.smoothing.smoother import TapedGaussian

# A step is smoothed from at least so many that follow, some five minutes; twice as many are in memory, 1.5 kB each.
STEPS_AHEAD = 2**15


@dataclass(slots=True, frozen=True)
class SmoothedStep:
    """One settled step and what became of it."""

    settled: Estimate
    displacement_m: float
    sigma_m: float
    velocity_m_s: float
    velocity_sigma_m_s: float
    speed_m_s: float  # the move's constant speed
    speed_sigma_m_s: float


class SettledSmoother:
    """Watches a pipeline, which must not be restored any more, and hands on its settled steps in order, smoothed.

    Which readings were used and which stop was reached stays as the filter decided; sigma takes that for right.
    """

    def __init__(
        self, pipeline: Pipeline, sink: Callable[[SmoothedStep], None], steps_ahead: int = STEPS_AHEAD
    ) -> None:
        filter_ = pipeline.state.settled.filter
        self._state = filter_.state = TapedGaussian(filter_.state, (P, V, SPEED))
        self._sink = sink
        self._steps_ahead = steps_ahead
        self._waiting: deque[Estimate] = deque()
        pipeline.on_settled = self._take

    def finish(self) -> None:
        """End of the data."""
        self._hand_on(keep=0)

    def _take(self, estimate: Estimate) -> None:
        self._state.mark()
        self._waiting.append(estimate)
        if len(self._waiting) == 2 * self._steps_ahead:
            self._hand_on(keep=self._steps_ahead)

    def _hand_on(self, keep: int) -> None:
        for (p, v, speed), (p_sigma, v_sigma, speed_sigma) in self._state.take(keep):
            self._sink(SmoothedStep(self._waiting.popleft(), p, p_sigma, v, v_sigma, speed, speed_sigma))
