"""Reading from a descriptor in the event loop, at a pace that leaves the loop and the processor to others."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

# After a full batch the reader rests this many times as long as the batch took, within bounds: a flood then
# costs at most a quarter of one processor, slow or fast. The kernel's buffer bridges the rest.
REST_SHARE = 3.0
SHORTEST_REST_S = 0.002
LONGEST_REST_S = 0.02


class PacedReader:
    """Calls `read` in the event loop whenever `descriptor` is readable.

    Args:
        descriptor: file descriptor to wait for.
        read: reads a batch; True if it was full, so that more may be waiting.
    """

    def __init__(self, descriptor: int, read: Callable[[], bool]) -> None:
        self._descriptor = descriptor
        self._read = read
        self._loop = asyncio.get_running_loop()
        self._resting: asyncio.TimerHandle | None = None
        self.failed: asyncio.Future[None] = self._loop.create_future()  # gets what `read` raised; reading has ended

    def start(self) -> None:
        """Begin to read."""
        self._resting = None
        self._loop.add_reader(self._descriptor, self._on_readable)

    def stop(self) -> None:
        """Read no more."""
        if self._resting is not None:
            self._resting.cancel()
        self._loop.remove_reader(self._descriptor)
        if not self.failed.cancel() and not self.failed.cancelled():
            self.failed.exception()  # looked at: no complaint that nobody did

    def _on_readable(self) -> None:
        began_s = time.perf_counter()
        try:
            full = self._read()
        except Exception as error:
            self._loop.remove_reader(self._descriptor)  # else it would fire again at once
            self.failed.set_exception(error)
            return
        if full:
            rest_s = REST_SHARE * (time.perf_counter() - began_s)
            self._loop.remove_reader(self._descriptor)
            self._resting = self._loop.call_later(min(max(rest_s, SHORTEST_REST_S), LONGEST_REST_S), self.start)
