"""When samples are read: learned period, phase, pace; without any part."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.data_ready import DataReadyError, Edge
from drivers.sample_timer import SampleTimer
from estimation.records import TimeKind

PERIOD_NS = 1_220_703.125
MS = 1_000_000


class Script:
    """A line whose edges come at given times, newest first counted."""

    def __init__(self, clock: VirtualClock, edges_ns: list[int]) -> None:
        self.clock = clock
        self.edges_ns = edges_ns
        self.closed = 0

    def wait(self, timeout_s: float) -> Edge | None:
        deadline_ns = self.clock.now_ns() + round(timeout_s * 1e9)
        if not self.edges_ns or self.edges_ns[0] > deadline_ns:
            self.clock.advance_to(deadline_ns)
            return None
        self.clock.advance_to(self.edges_ns[0])
        due = [edge_ns for edge_ns in self.edges_ns if edge_ns <= self.clock.now_ns()]
        del self.edges_ns[: len(due)]
        return Edge(due[-1], TimeKind.EDGE, len(due) - 1)

    def close(self) -> None:
        self.closed += 1


def running(edges_ns: list[int]) -> tuple[VirtualClock, SampleTimer]:
    clock = VirtualClock()
    line = Script(clock, edges_ns)
    timer = SampleTimer(clock, PERIOD_NS / 1e9, lambda: line)
    timer.skip()
    timer.begin()
    return clock, timer


def collect(clock: VirtualClock, timer: SampleTimer, until_ns: float) -> list[Edge]:
    edges = []
    while clock.now_ns() < until_ns:
        edge = timer.next(clock.now_ns() + 100 * MS)
        if edge is not None:
            edges.append(edge)
            clock.sleep(0.00025)
    return edges


@pytest.mark.parametrize("rate", [0.97, 1.0, 1.03])
def test_the_period_is_learned_through_jitter_glitches_and_gaps(rate: float) -> None:
    rng = np.random.default_rng(1)
    true_ns = PERIOD_NS / rate
    numbers = np.delete(np.arange(1, 4000), slice(500, 620))
    edges = [round(n * true_ns + rng.normal(0, 15_000)) for n in numbers]
    edges += [round(n * true_ns + 400_000) for n in range(100, 3000, 250)]
    clock, timer = running(sorted(edges))
    collect(clock, timer, 3999 * true_ns)
    # 1 us a period would be 1 ms of phase, a whole sample, in a second and a half of pacing.
    assert timer.period_ns == pytest.approx(true_ns, abs=0.5 * true_ns / 1024)


def test_until_an_edge_has_come_the_period_is_nominal() -> None:
    clock, timer = running([])
    assert timer.period_ns == pytest.approx(PERIOD_NS)
    assert not timer.knows_phase
    edges = collect(clock, timer, 1e9)
    assert {edge.kind for edge in edges} == {TimeKind.READ}
    assert np.diff([edge.t_ns for edge in edges]) == pytest.approx(PERIOD_NS, abs=2)


def test_paced_reads_keep_absolute_deadlines_however_long_the_reads_take() -> None:
    clock = VirtualClock()
    timer = SampleTimer(clock, 0.010, None)
    timer.begin()
    times = []
    for work_s in (0.001, 0.009, 0.0, 0.004):
        edge = timer.next(1 << 62)
        assert edge is not None
        times.append(edge.t_ns)
        clock.sleep(work_s)
    assert np.diff(times).tolist() == [10 * MS] * 3


def test_whole_periods_slept_through_in_paces_are_counted() -> None:
    clock = VirtualClock()
    timer = SampleTimer(clock, 0.010, None)
    timer.begin()
    timer.next(1 << 62)
    clock.sleep(0.0352)
    timer.next(1 << 62)
    assert timer.missed_paced == 2
    before_ns = clock.now_ns()
    edge = timer.next(1 << 62)
    assert edge is not None
    assert edge.t_ns - before_ns == pytest.approx(4.8 * MS, abs=1)
    assert timer.missed_paced == 2


def test_a_timer_that_must_step_aside_does_so_by_half_a_period() -> None:
    clock = VirtualClock()
    timer = SampleTimer(clock, 0.010, None)
    timer.begin()
    first = timer.next(1 << 62)
    timer.avoid_update()
    second = timer.next(1 << 62)
    assert first is not None
    assert second is not None
    assert second.t_ns - first.t_ns == 15 * MS


def test_nothing_is_returned_after_the_time_given() -> None:
    clock = VirtualClock()
    timer = SampleTimer(clock, 0.25, None)
    timer.begin()
    assert timer.next(100 * MS) is None
    assert clock.now_ns() == 100 * MS


def test_edges_before_the_start_are_counted_and_not_read() -> None:
    clock = VirtualClock()
    line = Script(clock, [round(n * PERIOD_NS) for n in range(1, 200)])
    timer = SampleTimer(clock, PERIOD_NS / 1e9, lambda: line)
    assert timer.skip() == 0
    clock.sleep(0.1)
    assert timer.skip() == int(0.1e9 // PERIOD_NS)
    timer.begin()
    edge = timer.next(1 << 62)
    assert edge is not None
    assert (edge.t_ns, edge.missed) == (round(82 * PERIOD_NS), 0)


def test_a_line_that_cannot_be_had_is_asked_for_once_a_second_and_reads_go_on() -> None:
    clock = VirtualClock()
    asked: list[int] = []

    def refuse() -> Script:
        asked.append(clock.now_ns())
        raise DataReadyError("busy")

    timer = SampleTimer(clock, PERIOD_NS / 1e9, refuse)
    timer.skip()
    timer.begin()
    edges = collect(clock, timer, 10e9)
    assert len(edges) == pytest.approx(10e9 / PERIOD_NS, abs=2)
    assert len(asked) == timer.line_failures == pytest.approx(10, abs=1)
    assert timer.line_error == "busy"
    assert timer.silences == 1


def test_a_floating_line_cannot_hold_up_the_start() -> None:
    clock = VirtualClock()

    class Floating(Script):
        def wait(self, timeout_s: float) -> Edge | None:
            return Edge(self.clock.now_ns(), TimeKind.EDGE)

    timer = SampleTimer(clock, PERIOD_NS / 1e9, lambda: Floating(clock, []))
    assert 0 < timer.skip() < 1000
