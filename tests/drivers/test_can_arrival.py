"""Times of frames by the kernel's wall-clock stamps: at any age, unless the wall clock was set."""

from __future__ import annotations

import time

import pytest

from drivers.can.arrival import ArrivalTimes
from drivers.clock import VirtualClock

AHEAD_NS = 1_000_000_000_000_000  # of the wall clock
MS = 1_000_000
SECOND = 1000 * MS


class Clocks:
    """A monotonic and a wall clock that can be set, and the times made from both."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.monotonic = VirtualClock(100 * SECOND)
        self.ahead_ns = AHEAD_NS
        monkeypatch.setattr(time, "time_ns", self.wall_ns)
        self.times = ArrivalTimes(self.monotonic)

    def wall_ns(self) -> int:
        return self.monotonic.now_ns() + self.ahead_ns

    def stamp_s(self) -> float:
        """What the kernel would write on a frame that comes now."""
        return self.wall_ns() * 1e-9


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> Clocks:
    return Clocks(monkeypatch)


def test_frames_read_after_a_standstill_keep_their_own_times(clocks: Clocks) -> None:
    expected, stamps = [], []
    for _ in range(60):
        expected.append(clocks.monotonic.now_ns())
        stamps.append(clocks.stamp_s())
        clocks.monotonic.sleep(0.05)
    # A stamp is a float: at 1e6 s it resolves 0.1 us.
    assert [clocks.times.of(stamp) for stamp in stamps] == pytest.approx(expected, abs=1000, rel=0)
    assert not clocks.times.check()


def test_a_stamp_of_the_future_means_now(clocks: Clocks) -> None:
    assert clocks.times.of(clocks.stamp_s() + 0.5) == clocks.monotonic.now_ns()


@pytest.mark.parametrize("step_ns", [-3600 * SECOND, -20 * MS, 20 * MS, 3600 * SECOND])
def test_after_a_setting_no_stamp_is_believed_until_those_of_before_have_been_read(
    clocks: Clocks, step_ns: int
) -> None:
    old = clocks.stamp_s()
    clocks.monotonic.sleep(0.03)
    clocks.ahead_ns += step_ns
    assert clocks.times.of(old) == clocks.monotonic.now_ns()
    assert clocks.times.check()
    assert clocks.times.of(old) == clocks.monotonic.now_ns()
    clocks.monotonic.sleep(1.0)
    assert not clocks.times.check()
    new, came_ns = clocks.stamp_s(), clocks.monotonic.now_ns()
    clocks.monotonic.sleep(0.2)
    assert clocks.times.of(new) == pytest.approx(came_ns, abs=1000, rel=0)


def test_a_wall_clock_that_is_slewed_was_not_set(clocks: Clocks) -> None:
    for _ in range(100):
        clocks.monotonic.sleep(5.0)
        clocks.ahead_ns += 5 * 500_000  # 500 ppm
        assert clocks.times.of(clocks.stamp_s() - 0.2) == pytest.approx(
            clocks.monotonic.now_ns() - 200 * MS, abs=1000, rel=0
        )
        assert not clocks.times.check()


def test_a_program_that_is_interrupted_between_the_two_clocks_takes_that_for_no_setting(
    clocks: Clocks, monkeypatch: pytest.MonkeyPatch
) -> None:
    interruptions = [0.02, 0.02]

    def late_wall_ns() -> int:
        if interruptions:
            clocks.monotonic.sleep(interruptions.pop())
        return clocks.wall_ns()

    monkeypatch.setattr(time, "time_ns", late_wall_ns)
    assert not clocks.times.check()
    assert not interruptions


def test_a_bus_that_is_opened_after_a_setting_believes_its_stamps(clocks: Clocks) -> None:
    clocks.ahead_ns += 3600 * SECOND
    clocks.times.restart()
    stamp, came_ns = clocks.stamp_s(), clocks.monotonic.now_ns()
    clocks.monotonic.sleep(0.2)
    assert clocks.times.of(stamp) == pytest.approx(came_ns, abs=1000, rel=0)
    assert not clocks.times.check()
