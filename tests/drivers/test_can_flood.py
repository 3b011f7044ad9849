"""Too much on the bus: others get their turns, the processor its rest, wanted frames arrive, losses are counted."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can import reader
from drivers.can.bus import FRAMES_PER_WAKE, CanBus
from drivers.can.frame import Frame, FrameId
from drivers.can.intake import ERROR_FRAMES_PER_S, FRAMES_PER_S, CanCounters
from drivers.can.interface import kernel_drops
from drivers.can.rate import RecentCount, TokenBudget
from drivers.can.settings import CanSettings
from drivers.clock import VirtualClock
from drivers.condition import Wellness
from drivers.virtual.can_network import NetworkBus, error_message
from tests.drivers.can_bench import Bench, ReadableBus, message, nobody, openings, run

WANTED = FrameId(0x310)


def accounted(counters: CanCounters) -> int:
    return counters.received + counters.overload + counters.kernel_drops + counters.ignored


def endless(item: can.Message) -> Callable[[CanSettings, object], can.BusABC]:
    return openings(lambda channel: ReadableBus(channel, item))


# --- the loop and the processor -------------------------------------------------------------------------------


async def turns_of_others(for_s: float) -> int:
    turns, end_s = 0, time.monotonic() + for_s
    while time.monotonic() < end_s:
        await asyncio.sleep(0.002)
        turns += 1
    return turns


def test_flood_leaves_the_event_loop_time_for_others() -> None:
    turns: dict[str, int] = {}

    async def scenario() -> None:
        async with Bench():
            turns["quiet"] = await turns_of_others(0.5)
        async with Bench(opener=endless(message(1)), ids=[WANTED]) as bench:
            turns["flood"] = await turns_of_others(0.5)
            assert bench.link.counters.ignored > 10 * FRAMES_PER_WAKE
            assert bench.link.progress == 0  # before the first second; the next test looks at what follows

    run(scenario())
    assert turns["flood"] > 0.5 * turns["quiet"]


def test_supervision_goes_on_in_a_flood(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.can.bus.SUPERVISE_S", 0.02)

    async def scenario() -> None:
        async with Bench(opener=endless(message(1)), ids=[WANTED]) as bench:
            await bench.until(lambda: bench.link.progress >= 10)

    run(scenario())


def busy_share() -> float:
    """The share of one processor that a flood of wanted frames takes."""
    shares: list[float] = []

    async def scenario() -> None:
        async with Bench(opener=endless(message(0x310)), ids=[WANTED]):
            cpu_s, wall_s = time.process_time(), time.perf_counter()
            await asyncio.sleep(0.5)
            shares.append((time.process_time() - cpu_s) / (time.perf_counter() - wall_s))

    run(scenario())
    return shares[0]


def test_flood_does_not_eat_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    paced = busy_share()
    monkeypatch.setattr(reader, "SHORTEST_REST_S", 0.0)
    monkeypatch.setattr(reader, "LONGEST_REST_S", 0.0)
    assert paced < 0.6 * busy_share()


# --- wanted frames --------------------------------------------------------------------------------------------


def test_wanted_frames_arrive_in_a_flood_of_others() -> None:
    async def scenario() -> None:
        sent = 0
        async with Bench(ids=[WANTED]) as bench:
            for number in range(60):
                for _ in range(100):
                    bench.peer.send(message(0x7FF))
                bench.peer.send(can.Message(arbitration_id=0x310, data=[number], is_extended_id=False))
                sent += 101
                await bench.until(lambda sent=sent: accounted(bench.link.counters) == sent)  # type: ignore[misc]
            counters = bench.link.counters
            assert [frame.data[0] for frame in bench.frames] == list(range(60))
            assert (counters.ignored, counters.overload, counters.kernel_drops) == (6000, 0, 0)
            assert bench.link.condition.word is Wellness.OK

    run(scenario())


@pytest.mark.parametrize("unwanted_per_wanted", [0, 1, 7])
def test_every_frame_is_accounted_for_in_a_flood(unwanted_per_wanted: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.can.bus.SUPERVISE_S", 0.02)

    async def scenario() -> None:
        sent = 0
        async with Bench(ids=[WANTED]) as bench:
            for _ in range(6):
                for number in range(1000):
                    wanted = number % (unwanted_per_wanted + 1) == 0
                    bench.peer.send(message(0x310 if wanted else 0x311))
                    sent += 1
                await asyncio.sleep(0.005)
            await bench.until(lambda: accounted(bench.link.counters) == sent)
        counters = bench.link.counters
        assert counters.kernel_drops > 0
        assert accounted(counters) == sent
        assert len(bench.frames) == counters.received

    run(scenario())


def test_excess_is_counted_exactly_and_told() -> None:
    clock = VirtualClock()
    bench = Bench(clock=clock, ids=[WANTED])
    bench.link.drain()
    handed_on = 0
    for _ in range(5000 // 100):
        for _ in range(100):
            bench.peer.send(message(0x310))
        bench.peer.send(message(0x311))
        handed_on += len(bench.link.drain())
    counters = bench.link.counters
    assert handed_on == counters.received == FRAMES_PER_S
    assert (counters.overload, counters.ignored, counters.kernel_drops) == (5000 - FRAMES_PER_S, 50, 0)
    assert "3000 in excess" in bench.link.condition.what
    assert "candump" in bench.link.condition.advice
    clock.sleep(0.01)
    for _ in range(100):
        bench.peer.send(message(0x310))
    assert len(bench.link.drain()) == FRAMES_PER_S // 100
    clock.sleep(11.0)
    bench.peer.send(message(0x310))
    bench.link.drain()
    assert bench.link.condition.word is Wellness.OK
    bench.link.close()


def test_frames_for_which_the_buffer_had_no_room_are_counted_and_told() -> None:
    clock = VirtualClock()
    bench = Bench(clock=clock, ids=[WANTED])
    bench.link.drain()
    for _ in range(2000):
        bench.peer.send(message(0x310))
    clock.sleep(1.0)
    read = len(bench.link.drain())
    counters = bench.link.counters
    assert read + counters.kernel_drops == 2000
    assert f"{counters.kernel_drops} frames" in bench.link.condition.what
    bench.link.close()


def test_losses_of_a_bus_that_fails_are_counted_once() -> None:
    clock = VirtualClock()
    bench = Bench(clock=clock, ids=[WANTED])
    bench.link.drain()
    for _ in range(1000):
        bench.peer.send(message(0x310))
    received = len(bench.link.drain())
    bench.network.exists = False
    bench.link.drain()
    bench.link.close()
    assert bench.link.counters.kernel_drops == 1000 - received


def test_flood_of_error_frames_is_taken_into_account_but_not_handed_on() -> None:
    clock = VirtualClock()
    bench = Bench(clock=clock, ids=[WANTED])
    bench.link.drain()
    handed_on = 0
    for _ in range(10):
        for _ in range(100):
            bench.network.deliver(error_message(0x88, b"\0\0\x04\0\0\0\0\0"))
        bench.network.deliver(message(0x310))
        handed_on += len(bench.link.drain())
    counters = bench.link.counters
    assert counters.error_frames == ERROR_FRAMES_PER_S
    assert counters.error_frames + counters.error_overload == 1000
    assert handed_on == ERROR_FRAMES_PER_S + counters.received == ERROR_FRAMES_PER_S + 10
    assert bench.link.errors.kinds == {"bus error": 1000, "stuff error": 1000}
    assert "1000 error frames" in bench.link.condition.what
    bench.link.close()


# --- the kernel's own count -----------------------------------------------------------------------------------


def test_kernel_counts_what_a_socket_had_no_room_for() -> None:
    settings_ = CanSettings(interface="udp_multicast", channel="239.74.163.92", port=43195, listen_only=False)
    clock = VirtualClock()
    receiver = CanBus(settings_, nobody, clock, [WANTED])
    sender = CanBus(settings_, nobody, clock)
    receiver.drain()
    sender.drain()
    if receiver.condition.what or sender.condition.what:
        pytest.fail(f"No multicast on this computer, the test needs it: {receiver.condition}")
    for number in range(3000):
        assert sender.send(Frame(0, 0x310 + number % 2, bytes(8)))
    sender.close()
    while receiver.drain():
        clock.sleep(1.0)
    receiver.close()
    assert receiver.counters.kernel_drops > 0
    assert accounted(receiver.counters) == 3000


def test_asking_for_the_losses_leaves_the_bus_open() -> None:
    with NetworkBus("drops") as bus:
        bus.lost = 7
        assert kernel_drops(bus) == 7
    with can.Bus(interface="udp_multicast", channel="239.74.163.92", port=43196, ignore_config=True) as multicast:
        assert kernel_drops(multicast) == 0
        assert kernel_drops(multicast) == 0
        assert multicast.recv(0) is None


# --- rates ----------------------------------------------------------------------------------------------------


@given(gaps_ms=st.lists(st.integers(0, 2000), max_size=200), per_s=st.integers(1, 50), burst=st.integers(1, 20))
@settings(derandomize=True, deadline=None, max_examples=100)
def test_budget_never_gives_more_than_its_rate(gaps_ms: list[int], per_s: int, burst: int) -> None:
    budget, now_ms, taken = TokenBudget(per_s, burst), 0, []
    for gap in gaps_ms:
        now_ms += gap
        if budget.take(now_ms * 1_000_000):
            taken.append(now_ms)
    for first in range(len(taken)):
        for last in range(first, len(taken)):
            allowed = burst + per_s * (taken[last] - taken[first]) / 1000
            assert last - first + 1 <= allowed + 1e-6


def test_budget_gives_its_rate() -> None:
    budget = TokenBudget(100, 10)
    assert sum(budget.take(t_ms * 1_000_000) for t_ms in range(10_000)) == 10 + 999


@given(st.lists(st.integers(0, 300), max_size=200))
@settings(derandomize=True, deadline=None, max_examples=100)
def test_recent_count_is_right_to_a_tenth_of_its_window(gaps_ms: list[int]) -> None:
    recent, now_ms, times = RecentCount(1.0), 0, []
    for gap in gaps_ms:
        now_ms += gap
        times.append(now_ms)
        recent.add(now_ms * 1_000_000)
        certainly = sum(now_ms - t_ms < 900 for t_ms in times)
        possibly = sum(now_ms - t_ms < 1000 for t_ms in times)
        assert certainly <= recent.count(now_ms * 1_000_000) <= possibly
    assert recent.count((now_ms + 1000) * 1_000_000) == 0
