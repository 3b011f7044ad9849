"""Ctrl-C: ends a command at any moment, in order."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Another Ctrl-C so soon is the same wish; it must not break off the clearing up.
SAME_WISH_S = 1.0
_AGAIN_S = 0.05


class Interrupt:
    """A handler of SIGINT that raises KeyboardInterrupt."""

    def __init__(self) -> None:
        self._at_s: float | None = None

    @property
    def has_come(self) -> bool:
        """There was one."""
        return self._at_s is not None

    def __call__(self, _number: int, _frame: FrameType | None) -> None:
        """SIGINT has come."""
        now_s = time.monotonic()
        if self._at_s is None or now_s - self._at_s > SAME_WISH_S:
            self._at_s = now_s
            raise KeyboardInterrupt

    def see_swallowed(self, unraisable: sys.UnraisableHookArgs) -> None:
        """A hook for errors that cannot be raised: an interrupt that fell into a finalizer comes again."""
        if unraisable.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(unraisable)
            return
        self._at_s = None
        # A real signal, which also ends a sleep of the main thread.
        main = threading.main_thread().ident
        assert main is not None
        again = threading.Timer(_AGAIN_S, signal.pthread_kill, (main, signal.SIGINT))
        again.daemon = True
        again.start()


@contextmanager
def interruptible(*, is_program: bool) -> Iterator[Interrupt]:
    """Within it Ctrl-C raises KeyboardInterrupt once; where it meant something else before, it goes on meaning that.

    is_program: nothing but the end of the program follows.
    """
    interrupt = Interrupt()
    is_ours = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if not is_ours:
        yield interrupt
        return
    hook = sys.unraisablehook
    signal.signal(signal.SIGINT, interrupt)
    sys.unraisablehook = interrupt.see_swallowed
    try:
        yield interrupt
    finally:
        sys.unraisablehook = hook
        # Nothing shall disturb the end of the program.
        is_ending = is_program or interrupt.has_come
        signal.signal(signal.SIGINT, signal.SIG_IGN if is_ending else signal.default_int_handler)
