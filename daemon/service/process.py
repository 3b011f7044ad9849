"""Set-up of a process that must not pause."""

from __future__ import annotations

import gc
import sys

# The reader thread must get the interpreter within half a millisecond: the part has no FIFO.
SWITCH_INTERVAL_S = 0.0005


def settle_process() -> None:
    """Collect once, then spare the collector what will live for ever: a full pass costs dozens of samples."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 50, 1000)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
