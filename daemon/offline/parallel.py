"""Work on many cases in several processes; an interrupt ends them at once."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from typing import TypeVar

Case = TypeVar("Case")
Result = TypeVar("Result")


def parallel(work: Callable[[Case], Result], cases: Sequence[Case], jobs: int) -> Iterator[Result]:
    """`work` of each case, as it is done; with one job in order and in this process."""
    if jobs == 1:
        yield from map(work, cases)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        try:
            with _workers_deaf_to_interrupts():
                futures = [pool.submit(work, case) for case in cases]
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            # Nobody waits for what is queued or half done.
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise


@contextmanager
def _workers_deaf_to_interrupts() -> Iterator[None]:
    """Processes started within it inherit that: Ctrl-C reaches them too, and it is for us to end them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
