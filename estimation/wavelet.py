"""Causal coiflet de-noising for display and control chart: the level-2 approximation, details d1 and d2 gone.

The à-trous (stationary) transform's smooth part of the last 16 samples: 11 ms late at 819.2 Hz. De-trending (dropping
the deepest approximation, paper C, eq. (1)-(3)) is left to the batch methods: it removes the burst itself.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import pywt

from estimation.records import Vector


def _level_2_taps(wavelet: str) -> tuple[float, ...]:
    """Impulse response of two à-trous smoothings, newest sample first, unit gain."""
    low = [value / 2**0.5 for value in pywt.Wavelet(wavelet).dec_lo]
    taps = [0.0] * (3 * (len(low) - 1) + 1)
    for i, a in enumerate(low):
        for j, b in enumerate(low):
            taps[i + 2 * j] += a * b
    return tuple(taps)


TAPS = _level_2_taps("coif1")


@dataclass(slots=True)
class CausalSmoother:
    """Remembers just as many vectors as the filter is long."""

    recent: deque[Vector] = field(default_factory=deque)

    def __post_init__(self) -> None:
        self.recent = deque(self.recent, maxlen=len(TAPS))  # a snapshot forgets the bound

    def add(self, v: Vector) -> None:
        """Take the next sample."""
        self.recent.append(v)

    def value(self) -> Vector:
        """Smooth value now; before the filter is full, the oldest sample stands for the unknown past."""
        x = y = z = 0.0
        last = len(self.recent) - 1
        for k, tap in enumerate(TAPS):
            v = self.recent[max(last - k, 0)]
            x += tap * v[0]
            y += tap * v[1]
            z += tap * v[2]
        return (x, y, z)

    def clear(self) -> None:
        """Forget the past: a gap lies between."""
        self.recent.clear()
