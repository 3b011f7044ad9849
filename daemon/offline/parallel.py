"""Work on many cases in several processes; an interrupt ends them at once."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

Case = TypeVar("Case")
Result = TypeVar("Result")


def parallel(work: Callable[[Case], Result], cases: Sequence[Case], jobs: int) -> Iterator[Result]:
    """`work` of each case, as it is done; with one job in order and in this process."""
    if jobs == 1:
        yield from map(work, cases)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _end_on_interrupt) as pool:
        try:
            for future in as_completed([pool.submit(work, case) for case in cases]):
                yield future.result()
        except BaseException:
            # Nobody waits for what is queued or half done.
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise


def _end_on_interrupt() -> None:
    """In a worker: Ctrl-C ends it at once, without a traceback of its own."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
