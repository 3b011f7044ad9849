"""Lateness of the event loop, and its culprit."""

from __future__ import annotations

import gc

import pytest

from daemon.service.loop_watch import Lateness, LoopWatch


class Clocks:
    """Wall, process and thread time, moved by hand [s]."""

    def __init__(self) -> None:
        self.wall = self.process = self.thread = 100.0

    def pass_(self, wall: float, process: float = 0.0, thread: float = 0.0) -> None:
        self.wall += wall
        self.process += process
        self.thread += thread


@pytest.fixture
def clocks() -> Clocks:
    return Clocks()


@pytest.fixture
def watch(clocks: Clocks) -> LoopWatch:
    return LoopWatch(lambda: clocks.wall, lambda: clocks.process, lambda: clocks.thread)


def test_a_loop_in_time_has_nothing_to_tell(watch: LoopWatch, clocks: Clocks) -> None:
    clocks.pass_(0.1)
    watch.woke(clocks.wall)
    assert watch.take() == Lateness()


def test_the_work_that_took_most_of_the_lateness_is_named(watch: LoopWatch, clocks: Clocks) -> None:
    due = clocks.wall + 0.1
    with watch.doing("early work"):
        clocks.pass_(0.099, 0.099, 0.099)
    with watch.doing("CAN frames"):
        clocks.pass_(0.010, 0.010, 0.010)
    with watch.doing("inertial samples"):
        clocks.pass_(0.050, 0.050, 0.050)
    watch.woke(due)
    worst = watch.take()
    assert worst.late_s == pytest.approx(0.059)
    assert worst.culprit == "inertial samples"
    assert worst.culprit_s == pytest.approx(0.050)


def test_many_pieces_of_the_same_work_count_together(watch: LoopWatch, clocks: Clocks) -> None:
    due = clocks.wall
    for _ in range(10):
        with watch.doing("CAN frames"):
            clocks.pass_(0.004, 0.004, 0.004)
        with watch.doing("a viewer"):
            clocks.pass_(0.003, 0.003, 0.003)
    watch.woke(due)
    assert watch.take().culprit == "CAN frames"


@pytest.mark.parametrize(
    ("process", "thread", "culprit"),
    [
        (0.2, 0.2, "work without a name"),
        (0.2, 0.0, "another thread of this program"),
        (0.0, 0.0, "the computer, busy with something else"),
    ],
)
def test_what_nobody_named_is_told_by_processor_time(
    watch: LoopWatch, clocks: Clocks, process: float, thread: float, culprit: str
) -> None:
    due = clocks.wall
    clocks.pass_(0.2, process, thread)
    watch.woke(due)
    assert watch.take().culprit == culprit


def test_work_before_the_timer_was_due_is_not_to_blame(watch: LoopWatch, clocks: Clocks) -> None:
    with watch.doing("finished long ago"):
        clocks.pass_(0.5, 0.5, 0.5)
    watch.woke(clocks.wall)
    due = clocks.wall + 0.1
    clocks.pass_(0.3)
    watch.woke(due)
    worst = watch.take()
    assert worst.culprit == "the computer, busy with something else"
    assert worst.late_s == pytest.approx(0.2)
    assert worst.culprit_s == pytest.approx(0.2)


def test_only_the_worst_is_kept_until_it_is_taken(watch: LoopWatch, clocks: Clocks) -> None:
    for late in (0.02, 0.3, 0.1):
        clocks.pass_(late)
        watch.woke(clocks.wall - late)
    assert watch.take().late_s == pytest.approx(0.3)
    assert watch.take() == Lateness()


def test_the_garbage_collector_is_seen(watch: LoopWatch, clocks: Clocks) -> None:
    class Slow:
        """Takes its time to die."""

        def __init__(self) -> None:
            self.me = self

        def __del__(self) -> None:
            clocks.pass_(0.2, 0.2, 0.2)

    gc.collect()
    watch.watch_collector()
    try:
        due = clocks.wall
        Slow()
        gc.collect()
        watch.woke(due)
        assert watch.take().culprit == "garbage collection"
    finally:
        watch.forget_collector()
    callbacks = len(gc.callbacks)
    watch.forget_collector()
    assert len(gc.callbacks) == callbacks
