"""The CAN link on a bus that works, or that fails in ways of its own: reading, reopening, sending, draining."""

from __future__ import annotations

import asyncio
import errno
import itertools
import json
import socket
import time
from typing import Any

import can
import pytest

from drivers.can.bus import CanBus, backoff_s
from drivers.can.frame import Frame, FrameId
from drivers.can.settings import CanSettings
from drivers.clock import SystemClock, VirtualClock
from drivers.condition import Wellness
from drivers.virtual.can_network import NetworkBus, network
from tests.drivers.can_bench import (
    Bench,
    OddBus,
    ReadableBus,
    cancel,
    message,
    nobody,
    openings,
    run,
    unused_channel,
)

GROUP, PORT = "239.74.163.91", 43191


@pytest.fixture
def no_waiting(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Waits between tries take no time; the list tells how long they would have been."""
    waits: list[float] = []
    sleep = asyncio.sleep

    async def note(delay: float) -> None:
        if delay != 0.001:  # the test's own
            waits.append(delay)
        await sleep(0)

    monkeypatch.setattr(asyncio, "sleep", note)
    return waits


def test_frames_arrive_in_order_and_unchanged() -> None:
    async def scenario() -> None:
        async with Bench() as bench:
            bench.peer.send(can.Message(arbitration_id=0x123, data=b"\x01\x02", is_extended_id=False))
            bench.peer.send(can.Message(arbitration_id=0x123, data=bytes(48), is_extended_id=True, is_fd=True))
            bench.peer.send(can.Message(arbitration_id=0x7, is_remote_frame=True, is_extended_id=False))
            await bench.frames_come(3)
            assert bench.link.condition.word is Wellness.OK
        t_ns = [frame.t_ns for frame in bench.frames]
        assert bench.frames == [
            Frame(t_ns[0], 0x123, b"\x01\x02"),
            Frame(t_ns[1], 0x123, bytes(48), is_extended=True, is_fd=True),
            Frame(t_ns[2], 0x7, b"", is_remote=True),
        ]
        assert t_ns == sorted(t_ns)
        assert (bench.link.counters.received, bench.link.counters.failures) == (3, 0)
        assert bench.link.condition.what.endswith("is closed")

    run(scenario())


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (can.CanOperationError("Network is down", errno.ENETDOWN), "Network is down"),
        (OSError(errno.ENODEV, "No such device"), "No such device"),
        (AssertionError("only requested a single extra field"), "single extra field"),
        (ValueError(), "ValueError"),
        (KeyError("odd"), "odd"),
    ],
)
def test_bus_that_fails_while_reading_is_closed_and_opened_anew(
    no_waiting: list[float], error: Exception, words: str
) -> None:
    async def scenario() -> None:
        made: list[OddBus] = []

        def first(channel: str) -> can.BusABC:
            made.append(OddBus(channel, message(1), error))
            return made[0]

        async with Bench(opener=openings(first, lambda channel: OddBus(channel, message(2)))) as bench:
            await bench.frames_come(2)
            assert [frame.arbitration_id for frame in bench.frames] == [1, 2]
            assert made[0].closed
            assert (bench.link.counters.failures, bench.link.counters.reconnects) == (1, 1)
            assert bench.link.last_error.startswith(f"virtual {bench.settings.channel}: ")
            assert words in bench.link.last_error

    run(scenario())


def test_waits_double_up_to_five_seconds_and_start_anew_after_a_frame(no_waiting: list[float]) -> None:
    missing = OSError(errno.ENODEV, "No such device")
    progress: list[int] = []

    async def scenario() -> None:
        opener = openings(*[missing] * 8, lambda channel: OddBus(channel, message(1), missing), missing)
        async with Bench(opener=opener) as bench:
            await bench.until(lambda: bench.link.counters.failures == 11)
            progress.append(bench.link.progress)

    run(scenario())
    # What is longer than a second is waited for in pieces, each of which shows that the task lives.
    assert max(no_waiting) <= 1.0
    expected = [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 0.1, 0.2]
    pieces = iter(no_waiting)
    for whole in expected:
        waited = 0.0
        while waited < whole - 1e-9:
            waited += next(pieces)
        assert waited == pytest.approx(whole)
    assert progress[0] >= 4 + 2 + 4 + 5 + 5 + 2


def test_backoff_never_ends() -> None:
    assert list(itertools.islice(backoff_s(), 100))[-1] == 5.0


def test_condition_says_what_is_waited_for(no_waiting: list[float]) -> None:
    async def scenario() -> None:
        missing = OSError(errno.ENODEV, "No such device")
        bench = Bench(opener=openings(missing, missing, NetworkBus))
        assert bench.link.condition.what.endswith("is not opened yet")
        async with bench:
            await bench.until(lambda: bench.link.counters.failures == 2)
            waiting = bench.link.condition
            assert waiting.word is Wellness.WAITING
            assert waiting.what == f"virtual {bench.settings.channel}: No such device"
            assert "plug it in" in waiting.advice
            await bench.until(lambda: bench.is_open)
            assert bench.link.counters.reconnects == 0  # it had never been open before

    run(scenario())


def test_mistake_of_the_receiver_is_not_taken_for_a_fault_of_the_bus() -> None:
    async def scenario() -> None:
        def fail(frame: Frame) -> None:
            raise RuntimeError("receiver")

        bench = Bench(on_frame=fail, opener=openings(lambda channel: OddBus(channel, message(1))))
        with pytest.raises(RuntimeError, match="receiver"):
            await bench.link.run()
        assert bench.link.counters.failures == 0

    run(scenario())


def test_descriptor_that_is_always_readable_without_a_frame_does_not_spin(no_waiting: list[float]) -> None:
    async def scenario() -> None:
        opener = openings(lambda channel: ReadableBus(channel, None), lambda channel: OddBus(channel, message(1)))
        async with Bench(opener=opener) as bench:
            await bench.frames_come(1)
            assert "always readable" in bench.link.last_error
            assert bench.link.counters.failures == 1

    run(scenario())


def test_bus_without_a_descriptor_is_refused_in_words(no_waiting: list[float]) -> None:
    class Blind(NetworkBus):
        def fileno(self) -> int:
            raise NotImplementedError("fileno is not implemented")

    async def scenario() -> None:
        async with Bench(opener=openings(Blind, NetworkBus)) as bench:
            await bench.until(lambda: bench.link.counters.reconnects == 1)
            assert "fileno" in bench.link.last_error

    run(scenario())


def test_only_wanted_identifiers_are_handed_on_and_the_others_counted() -> None:
    async def scenario() -> None:
        async with Bench(ids=[FrameId(0x10), FrameId(0x20, True)]) as bench:
            for number, extended in ((0x10, True), (0x11, False), (0x20, True), (0x20, False), (0x10, False)):
                bench.peer.send(can.Message(arbitration_id=number, is_extended_id=extended))
            await bench.frames_come(2)
            assert [frame.frame_id for frame in bench.frames] == [FrameId(0x20, True), FrameId(0x10)]
            assert (bench.link.counters.received, bench.link.counters.ignored) == (2, 3)

    run(scenario())


def arrival_s(monkeypatch: pytest.MonkeyPatch, *ages_s: float) -> list[float]:
    """Monotonic arrival times of frames whose kernel stamps are `ages_s` old, read at 100 s."""
    monkeypatch.setattr(time, "time_ns", lambda: 1_000_000_000_000_000)
    arrivals: list[float] = []

    async def scenario() -> None:
        script = [message(1, timestamp=1_000_000.0 - age) for age in ages_s]
        opener = openings(lambda channel: OddBus(channel, *script))
        async with Bench(clock=VirtualClock(100_000_000_000), opener=opener) as bench:
            await bench.frames_come(len(ages_s))
            arrivals.extend(frame.t_ns / 1e9 for frame in bench.frames)

    run(scenario())
    return arrivals


@pytest.mark.parametrize(
    ("age_s", "expected_s"),
    [(0.0, 100.0), (0.02, 99.98), (0.2, 99.8), (59.0, 41.0), (61.0, 100.0), (-3600.0, 100.0), (1e6, 100.0)],
)
def test_kernel_time_is_used_at_any_plausible_age(
    monkeypatch: pytest.MonkeyPatch, age_s: float, expected_s: float
) -> None:
    assert arrival_s(monkeypatch, age_s) == [pytest.approx(expected_s, abs=1e-6)]


def test_time_never_goes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    arrivals = arrival_s(monkeypatch, 0.03, 0.2, 0.01)
    assert arrivals == [pytest.approx(99.97), pytest.approx(99.97), pytest.approx(99.99)]
    assert arrivals == sorted(arrivals)


def test_settings_of_the_wall_clock_are_counted_by_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.can.bus.SUPERVISE_S", 0.01)
    wall_ns = [1_000_000_000_000_000]
    monkeypatch.setattr(time, "time_ns", lambda: wall_ns[0])

    async def scenario() -> None:
        async with Bench(clock=VirtualClock(100_000_000_000)) as bench:
            await bench.until(lambda: bench.link.progress >= 2)
            assert bench.link.counters.clock_steps == 0
            wall_ns[0] += 3_600_000_000_000
            before = bench.link.progress
            await bench.until(lambda: bench.link.progress >= before + 3)
            assert bench.link.report()["clock_steps"] == 1

    run(scenario())


def test_sending_is_refused_while_listening_only() -> None:
    async def scenario() -> None:
        async with Bench() as bench:
            assert not bench.link.send(Frame(1, 0x6F0, b"12345678"))
            assert bench.peer.recv(0) is None
            assert "`listen_only` forbids" in bench.link.last_error
            assert (bench.link.counters.sent, bench.link.counters.send_failures) == (0, 1)

    run(scenario())


def test_sent_frames_and_failures_to_send_are_counted() -> None:

    async def scenario() -> None:
        frame = Frame(1, 0x6F0, b"12345678")
        bench = Bench(listen_only=False, opener=openings(NetworkBus))
        assert not bench.link.send(frame)
        assert "not open" in bench.link.last_error
        async with bench:
            assert bench.link.send(frame)
            assert bench.link.send(Frame(1, 0x6F1, bytes(64), is_extended=True, is_fd=True))
            assert not bench.link.send(Frame(1, 0x6F0, bytes(9)))  # no classic frame has 9 bytes
            assert "fails" in bench.link.condition.what
            assert bench.link.send(frame)
            assert bench.link.condition.what == ""
            heard = [bench.peer.recv(0) for _ in range(3)]
            assert [(len(m.data), m.is_extended_id, m.is_fd) for m in heard if m is not None] == [
                (8, False, False),
                (64, True, True),
                (8, False, False),
            ]
            assert (bench.link.counters.sent, bench.link.counters.send_failures) == (3, 2)

    run(scenario())


@pytest.mark.parametrize(
    "error", [can.CanOperationError("Transmit buffer full"), OSError(105, "No buffer"), KeyError(1)]
)
def test_bus_that_cannot_send_goes_on_reading(error: Exception) -> None:
    async def scenario() -> None:
        opener = openings(lambda channel: OddBus(channel, send_error=error))
        async with Bench(listen_only=False, opener=opener) as bench:
            assert not bench.link.send(Frame(1, 0x6F0, b""))
            assert bench.link.last_error in bench.link.condition.what
            assert "alone on the bus" in bench.link.condition.advice
            bench.peer.send(message(1))
            await bench.frames_come(1)
            assert bench.link.counters.failures == 0

    run(scenario())


def test_failure_to_close_is_reported_and_does_no_harm() -> None:
    class Stubborn(NetworkBus):
        def shutdown(self) -> None:
            super().shutdown()
            raise can.CanError("stubborn")

    async def scenario() -> None:
        async with Bench(opener=openings(Stubborn)) as bench:
            pass
        assert "stubborn" in bench.link.last_error
        assert bench.link.condition.what.endswith("is closed")

    run(scenario())


def test_drain_reads_what_is_waiting_stamped_with_simulated_time() -> None:
    clock = VirtualClock(5_000)
    bench = Bench(clock=clock, ids=[FrameId(1), FrameId(2)], on_frame=nobody)
    assert bench.link.drain() == []
    for number in (1, 3, 2):
        bench.peer.send(message(number))
    assert bench.link.drain() == [Frame(5_000, 1, b"\x01"), Frame(5_000, 2, b"\x02")]
    assert bench.link.counters.ignored == 1
    clock.sleep(1.0)
    bench.peer.send(message(2))
    assert bench.link.drain() == [Frame(1_000_005_000, 2, b"\x02")]
    assert bench.link.progress == 1
    bench.link.close()


def test_drain_survives_a_bus_that_fails_and_opens_it_anew_when_it_is_time() -> None:
    down = can.CanOperationError("Network is down", errno.ENETDOWN)
    clock = VirtualClock(5)
    bench = Bench(
        clock=clock,
        opener=openings(
            lambda channel: OddBus(channel, message(1), down, message(2)),
            OSError(errno.ENODEV, "No such device"),
            lambda channel: OddBus(channel, message(3)),
        ),
    )
    assert bench.link.drain() == [Frame(5, 1, b"\x01")]
    assert "Network is down" in bench.link.condition.what
    assert bench.link.condition.advice == f"ip link set {bench.settings.channel} up"
    assert bench.link.drain() == []
    assert bench.link.counters.failures == 1  # not yet tried again
    clock.sleep(0.1)
    assert bench.link.drain() == []
    assert bench.link.counters.failures == 2
    clock.sleep(0.2)
    assert bench.link.drain() == [Frame(300_000_005, 3, b"\x03")]
    assert (bench.link.counters.failures, bench.link.counters.reconnects) == (2, 1)
    bench.link.close()


def test_endless_frames_do_not_keep_drain_for_ever() -> None:
    bench = Bench(
        clock=VirtualClock(), ids=[FrameId(1)], opener=openings(lambda channel: ReadableBus(channel, message(2)))
    )
    assert bench.link.drain() == []
    assert bench.link.counters.ignored == 4096
    bench.link.close()


def multicast_settings(port: int) -> CanSettings:
    return CanSettings(interface="udp_multicast", channel=GROUP, port=port, listen_only=False)


def test_two_programs_meet_over_local_multicast() -> None:
    async def scenario() -> None:
        frames: list[Frame] = []
        receiver = CanBus(multicast_settings(PORT), frames.append, SystemClock(), [FrameId(0x310)])
        sender = CanBus(multicast_settings(PORT), lambda frame: None, SystemClock())
        tasks = [asyncio.create_task(link.run()) for link in (receiver, sender)]
        for _ in range(10):
            await asyncio.sleep(0)
        if receiver.condition.what or sender.condition.what:
            pytest.fail(f"No multicast on this computer, the test needs it: {receiver.condition}, {sender.condition}")
        sent = [Frame(1, 0x310, bytes([number])) for number in range(20)]
        assert [sender.send(frame) for frame in sent] == [True] * 20
        async with asyncio.timeout(20):
            while len(frames) < 20:
                await asyncio.sleep(0.001)
        for task in tasks:
            await cancel(task)
        assert [frame.data for frame in frames] == [frame.data for frame in sent]
        now_ns = time.monotonic_ns()
        assert all(0 <= now_ns - frame.t_ns < 60e9 for frame in frames)

    run(scenario())


def test_garbage_on_multicast_is_a_failure_that_passes() -> None:
    async def scenario() -> None:
        frames: list[Frame] = []
        link = CanBus(multicast_settings(PORT + 1), frames.append, SystemClock())
        task = asyncio.create_task(link.run())
        for _ in range(10):
            await asyncio.sleep(0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as anyone:
            anyone.sendto(b"\xc1 no frame", (GROUP, PORT + 1))
            while not link.counters.reconnects:
                await asyncio.sleep(0.01)
        assert "could not unpack" in link.last_error
        assert link.send(Frame(1, 1, b"own"))  # multicast comes back to its sender
        while not frames:
            await asyncio.sleep(0.01)
        await cancel(task)

    run(scenario())


def test_whole_program_can_use_the_virtual_interface_by_its_settings() -> None:
    channel = unused_channel()
    links = [
        CanBus(CanSettings(interface="virtual", channel=channel, listen_only=False), nobody, VirtualClock())
        for _ in range(2)
    ]
    for link in links:
        assert link.drain() == []
    assert links[0].send(Frame(1, 0x6F0, b"to all"))
    assert [link.drain() for link in links] == [[], [Frame(0, 0x6F0, b"to all")]]
    for link in links:
        link.close()
    assert network(channel).exists


def test_report_can_be_written_as_json() -> None:
    report: dict[str, Any] = json.loads(json.dumps(Bench().link.report()))
    assert report["controller"] == "error-active"
    assert report["error_kinds"] == {}
