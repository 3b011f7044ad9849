"""What the kernels have seen of a step and what that says, in nats: step or none, step or pulse, still or moving."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from estimation.recognition.kernels import Kernel
from estimation.recognition.steps import StepBank

QUIET_ODDS = 3.0  # most that the vibration may say for or against a stop
QUIET_WINDOW_S = 0.3
QUIETEST_M_S2 = 0.01  # a vibration below this is none


@dataclass(slots=True, frozen=True)
class SeenStep:
    """A step that one kernel has seen."""

    t_ns: int
    x: float
    sigma: float
    index: int  # blocks ago


def evidence(x: float, sigma: float, speed: float, spread: float) -> float:
    """Log likelihood ratio of a step of size `speed` (spread as a share of it) against none; all in m/s, signed."""
    s0 = (1.15 * sigma) ** 2 + 0.0004**2
    s1 = s0 + (spread * speed) ** 2
    return float(0.5 * x * x / s0 - 0.5 * (x - speed) ** 2 / s1 - 0.5 * log(s1 / s0))


def sustained_evidence(x: float, sigma: float, speed: float) -> float:
    """The same of a sustained kernel against a pulse of speed, of which that kernel still hears a share."""
    s0 = (1.1 * sigma) ** 2 + (0.20 * speed) ** 2
    s1 = (1.1 * sigma) ** 2 + (0.12 * speed) ** 2
    pulse, step = 0.25 * speed, 0.96 * speed
    if x * speed > step * speed:
        x = step  # more than a whole step speaks for no pulse
    return float(0.5 * (x - pulse) ** 2 / s0 - 0.5 * (x - step) ** 2 / s1 - 0.5 * log(s1 / s0))


def largest(
    bank: StepBank, kernel: Kernel, t_ns: int, after_s: float, sign: int = 0, *, before_s: float, not_before_ns: int = 0
) -> SeenStep | None:
    """The largest step that one kernel has seen near a time: of one sign, or (0) of either."""
    times = np.fromiter(bank.times_ns, dtype=np.int64)
    post = bank.post_steps[kernel]
    judged = len(times) - post  # blocks whose step this kernel has seen whole
    if judged <= 0:
        return None
    event_times = times[:judged]
    x = bank.x.values[-judged:, kernel]
    earliest_ns = max(t_ns - before_s * 1e9, not_before_ns)
    near = (event_times >= earliest_ns) & (event_times <= t_ns + after_s * 1e9)
    if not near.any():
        return None
    size = np.where(near, np.abs(x) if sign == 0 else sign * x, -np.inf)
    i = int(np.argmax(size))
    return SeenStep(int(event_times[i]), float(x[i]), float(bank.sigma.values[-judged:, kernel][i]), judged - 1 - i)


def beside(bank: StepBank, kernel: Kernel, step: SeenStep) -> SeenStep:
    """What another kernel of the same reach said of the same step, at its best within 0.06 s."""
    direction = 1.0 if step.x > 0 else -1.0
    around = range(max(step.index - 6, 0), step.index + 7)
    rows = bank.x.values
    best = max((i for i in around if i < len(rows)), key=lambda i: direction * rows[-1 - i, kernel])
    return SeenStep(step.t_ns, float(rows[-1 - best, kernel]), float(bank.sigma.values[-1 - best, kernel]), best)


def quiet_evidence(bank: StepBank, step: SeenStep) -> float:
    """Nats that the vibration gives for a stop: has it fallen towards what it was at rest, or gone on as in motion?

    Only as far as rest and motion differ at all, and never much: a machine nearby may start or stop.
    """
    levels: Sequence[float] = bank.vibration
    end = len(levels) - 1
    stop = max(end - step.index - bank.post_steps[Kernel.STOP_LATE], 0)
    moving = _log_mean(levels[i] for i in range(max(stop - 60, 0), max(stop - 15, 1)))
    after = log(bank.vibration_lately_m_s2(QUIET_WINDOW_S) + QUIETEST_M_S2)
    resting = log(bank.level_at_rest_m_s2 + QUIETEST_M_S2)
    spread = 0.6
    fall = 0.5 * ((after - moving) ** 2 - (after - min(resting, moving)) ** 2) / spread**2
    return float(np.clip(fall, -QUIET_ODDS, QUIET_ODDS))


def _log_mean(levels: Iterable[float]) -> float:
    logs = [log(level + QUIETEST_M_S2) for level in levels]
    return sum(logs) / len(logs)
