"""How many per second: a budget to keep within, and a count of what was lately. Constant memory, any clock."""

from __future__ import annotations

_SLOTS = 10


class TokenBudget:
    """So many per second on average, and at most `burst` at once.

    Args:
        per_s: tokens that come back each second.
        burst: tokens that can be saved up; there at the start.
    """

    def __init__(self, per_s: float, burst: int) -> None:
        self._per_ns = per_s * 1e-9
        self._burst = float(burst)
        self._tokens = float(burst)
        self._last_ns: int | None = None

    def take(self, now_ns: int) -> bool:
        """Take one token; False if there is none."""
        if self._last_ns is not None and now_ns > self._last_ns:
            self._tokens = min(self._tokens + (now_ns - self._last_ns) * self._per_ns, self._burst)
        self._last_ns = now_ns if self._last_ns is None else max(now_ns, self._last_ns)
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True


class RecentCount:
    """How many of something were within the last `window_s` seconds, to a tenth of that time."""

    def __init__(self, window_s: float) -> None:
        self._slot_ns = round(window_s * 1e9 / _SLOTS)
        self._counts = [0] * _SLOTS
        self._newest = 0  # number of the newest slot since time zero

    def add(self, t_ns: int, count: int = 1) -> None:
        """Count `count` at `t_ns`."""
        self._advance(t_ns)
        self._counts[self._newest % _SLOTS] += count

    def count(self, now_ns: int) -> int:
        """The sum over the window that ends now."""
        self._advance(now_ns)
        return sum(self._counts)

    def _advance(self, t_ns: int) -> None:
        slot = t_ns // self._slot_ns
        for passed in range(max(self._newest + 1, slot - _SLOTS + 1), slot + 1):
            self._counts[passed % _SLOTS] = 0
        self._newest = max(self._newest, slot)
