"""Pushing written data to the disk without anybody waiting for it."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from queue import SimpleQueue

_MOST_WAITING = 8  # open descriptors that a hung disk may hold


class BackgroundSync:
    """A thread that runs fdatasync on request: it takes 10 ms on a good disk and seconds on a bad card.

    `on_error` is called, in that thread, with the `OSError` of a failed sync.
    """

    def __init__(self, on_error: Callable[[OSError], None]) -> None:
        self._on_error = on_error
        self._requests: SimpleQueue[int | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="recorder-sync", daemon=True)
        self._thread.start()

    def request(self, descriptor: int) -> None:
        """Sync the file of `descriptor`, which the caller may close at once; skipped behind a hung disk."""
        if self._requests.qsize() < _MOST_WAITING:
            self._requests.put(os.dup(descriptor))

    def close(self, timeout_s: float) -> bool:
        """Finish what was requested; False when the disk did not answer in time."""
        self._requests.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (descriptor := self._requests.get()) is not None:
            try:
                os.fdatasync(descriptor)
            except OSError as error:
                self._on_error(error)
            finally:
                os.close(descriptor)
