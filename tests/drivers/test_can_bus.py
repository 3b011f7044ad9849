from __future__ import annotations

import asyncio
import errno
import fcntl
import itertools
import select
import socket
import struct
import time
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any

import can
import pytest

from drivers.can.bus import FRAMES_PER_WAKE, CanBus, backoff_s
from drivers.can.frame import Frame, FrameId
from drivers.can.interface import require_interface_up
from drivers.can.settings import CanSettings
from drivers.clock import SystemClock, VirtualClock

SETTINGS = CanSettings(channel="test0")
SENDING = CanSettings(channel="test0", listen_only=False)
GROUP, PORT = "239.74.163.91", 43191


class SocketPairBus(can.BusABC):
    """A bus with a file descriptor, as SocketCAN is: whatever is queued comes out of `recv`, errors too."""

    def __init__(self) -> None:
        super().__init__("test0")
        self._near, self._far = socket.socketpair()
        self._queue: list[can.Message | Exception | None] = []
        self.sent: list[can.Message] = []
        self.send_error: Exception | None = None
        self.endless: can.Message | None = None
        self.closed = False

    def put(self, item: can.Message | Exception | None) -> None:
        """Make the descriptor readable; None = readable, but no frame."""
        self._queue.append(item)
        self._far.send(b"x")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.endless is not None:
            return self.endless, True
        if not select.select([self._near], [], [], timeout)[0]:
            return None, True
        item = self._queue.pop(0) if self._queue else None
        if item is not None:
            self._near.recv(1)  # None stays readable for ever
        if isinstance(item, Exception):
            raise item
        return item, True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.send_error is not None:
            raise self.send_error
        self.sent.append(msg)

    def fileno(self) -> int:
        return self._near.fileno()

    def shutdown(self) -> None:
        super().shutdown()
        self.closed = True
        self._near.close()
        self._far.close()


class Bench:
    """A CanBus whose every opening gives the next of `buses`, or raises it."""

    def __init__(self, *buses: SocketPairBus | Exception, settings: CanSettings = SETTINGS, **options: Any) -> None:
        self.frames: list[Frame] = []
        self.arrived = asyncio.Event()
        self.opened = asyncio.Event()
        self._buses = iter(buses)
        self.link = CanBus(
            settings,
            options.pop("on_frame", self._on_frame),
            options.pop("clock", SystemClock()),
            opener=self._open,
            **options,
        )

    def _open(self, settings: CanSettings, ids: object) -> can.BusABC:
        bus = next(self._buses, None)
        if bus is None:
            raise OSError(errno.ENODEV, "No such device")
        if isinstance(bus, Exception):
            raise bus
        self.opened.set()
        return bus

    def _on_frame(self, frame: Frame) -> None:
        self.frames.append(frame)
        self.arrived.set()

    async def wait_for(self, count: int) -> None:
        """Until `count` frames have arrived."""
        while len(self.frames) < count:
            self.arrived.clear()
            await asyncio.wait_for(self.arrived.wait(), 20)


def run(scenario: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(scenario, 60))


async def cancel(task: asyncio.Task[None]) -> None:
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task


def message(number: int, **options: Any) -> can.Message:
    return can.Message(arbitration_id=number, data=bytes([number % 256]), is_extended_id=False, **options)


def nobody(frame: Frame) -> None:
    pytest.fail(f"nobody expects {frame}")


@pytest.fixture
def no_waiting(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Waits between tries take no time; the list tells how long they would have been."""
    waits: list[float] = []
    sleep = asyncio.sleep

    async def note(delay: float) -> None:
        waits.append(delay)
        await sleep(0)

    monkeypatch.setattr(asyncio, "sleep", note)
    return waits


def test_frames_arrive_in_order_and_unchanged() -> None:
    async def scenario() -> None:
        bus = SocketPairBus()
        bench = Bench(bus)
        task = asyncio.create_task(bench.link.run())
        bus.put(can.Message(arbitration_id=0x123, data=b"\x01\x02", is_extended_id=False))
        bus.put(can.Message(arbitration_id=0x123, data=bytes(48), is_extended_id=True, is_fd=True))
        bus.put(can.Message(arbitration_id=0x7, is_remote_frame=True, is_extended_id=False))
        await bench.wait_for(3)
        assert bench.link.state == "running"
        await cancel(task)
        t_ns = [frame.t_ns for frame in bench.frames]
        assert bench.frames == [
            Frame(t_ns[0], 0x123, b"\x01\x02"),
            Frame(t_ns[1], 0x123, bytes(48), is_extended=True, is_fd=True),
            Frame(t_ns[2], 0x7, b"", is_remote=True),
        ]
        assert t_ns == sorted(t_ns)
        assert (bench.link.counters.received, bench.link.counters.failures) == (3, 0)
        assert bus.closed
        assert bench.link.state == "waiting: closed"

    run(scenario())


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (can.CanOperationError("Network is down", errno.ENETDOWN), "Network is down"),
        (OSError(errno.ENODEV, "No such device"), "No such device"),
        (AssertionError("only requested a single extra field"), "single extra field"),
        (ValueError(), "ValueError"),
    ],
)
def test_bus_that_fails_while_reading_is_closed_and_opened_anew(
    no_waiting: list[float], error: Exception, words: str
) -> None:
    async def scenario() -> None:
        first, second = SocketPairBus(), SocketPairBus()
        bench = Bench(first, second)
        task = asyncio.create_task(bench.link.run())
        first.put(message(1))
        first.put(error)
        second.put(message(2))
        await bench.wait_for(2)
        await cancel(task)
        assert [frame.arbitration_id for frame in bench.frames] == [1, 2]
        assert first.closed
        assert (bench.link.counters.failures, bench.link.counters.reconnects) == (1, 1)
        assert bench.link.last_error.startswith("socketcan test0: ")
        assert words in bench.link.last_error

    run(scenario())


def test_waits_double_up_to_five_seconds_and_start_anew_after_a_frame(no_waiting: list[float]) -> None:
    async def scenario() -> None:
        missing = OSError(errno.ENODEV, "No such device")
        bus = SocketPairBus()
        bus.put(message(1))
        bus.put(missing)
        bench = Bench(*[missing] * 8, bus, missing)
        task = asyncio.create_task(bench.link.run())
        await bench.wait_for(1)
        while len(no_waiting) < 11:
            await asyncio.sleep(0)
        await cancel(task)

    run(scenario())
    waits = [wait for wait in no_waiting if wait]
    assert waits[:10] == [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 0.1, 0.2]


def test_backoff_never_ends() -> None:
    assert list(itertools.islice(backoff_s(), 100))[-1] == 5.0


def test_state_says_what_is_waited_for_and_the_log_says_it_once(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario() -> None:
        bus = SocketPairBus()
        missing = OSError(errno.ENODEV, "No such device")
        bench = Bench(missing, missing, bus)
        assert bench.link.state == "waiting: not opened yet"
        task = asyncio.create_task(bench.link.run())
        while bench.link.counters.failures < 2:
            await asyncio.sleep(0)
        assert bench.link.state == "waiting: socketcan test0: No such device"
        await asyncio.wait_for(bench.opened.wait(), 20)
        assert bench.link.state == "running"
        assert bench.link.counters.reconnects == 0  # it had never been open before
        await cancel(task)

    run(scenario())
    assert [record.levelname for record in caplog.records].count("WARNING") == 1


def test_mistake_of_the_receiver_is_not_taken_for_a_fault_of_the_bus() -> None:
    async def scenario() -> None:
        def fail(frame: Frame) -> None:
            raise RuntimeError("receiver")

        bus = SocketPairBus()
        bus.put(message(1))
        bench = Bench(bus, on_frame=fail)
        with pytest.raises(RuntimeError, match="receiver"):
            await bench.link.run()
        assert bench.link.counters.failures == 0
        assert bus.closed

    run(scenario())


def test_flood_leaves_the_event_loop_time_for_others() -> None:
    async def scenario() -> None:
        bus = SocketPairBus()
        bus.endless = message(1)
        bus.put(None)
        bench = Bench(bus)
        task = asyncio.create_task(bench.link.run())
        await bench.wait_for(1)
        for _ in range(50):
            before = len(bench.frames)
            await asyncio.sleep(0)
            assert len(bench.frames) - before <= FRAMES_PER_WAKE
        assert len(bench.frames) > 10 * FRAMES_PER_WAKE
        await cancel(task)

    run(scenario())


def test_descriptor_that_is_always_readable_without_a_frame_does_not_spin(no_waiting: list[float]) -> None:
    async def scenario() -> None:
        broken, good = SocketPairBus(), SocketPairBus()
        broken.put(None)
        good.put(message(1))
        bench = Bench(broken, good)
        task = asyncio.create_task(bench.link.run())
        await bench.wait_for(1)
        await cancel(task)
        assert broken.closed
        assert "always readable" in bench.link.last_error

    run(scenario())


def test_only_wanted_identifiers_are_handed_on_and_the_others_counted() -> None:
    async def scenario() -> None:
        bus = SocketPairBus()
        bench = Bench(bus, ids=[FrameId(0x10), FrameId(0x20, True)])
        task = asyncio.create_task(bench.link.run())
        for number, extended in ((0x10, True), (0x11, False), (0x20, True), (0x20, False), (0x10, False)):
            bus.put(can.Message(arbitration_id=number, is_extended_id=extended))
        await bench.wait_for(2)
        await cancel(task)
        assert [frame.frame_id for frame in bench.frames] == [FrameId(0x20, True), FrameId(0x10)]
        assert (bench.link.counters.received, bench.link.counters.ignored) == (2, 3)

    run(scenario())


def error_frame(error_class: int, detail: int = 0) -> can.Message:
    return can.Message(
        arbitration_id=error_class,
        data=bytes([0, detail, 0, 0, 0, 0, 0, 0]),
        is_extended_id=False,
        is_error_frame=True,
    )


@pytest.mark.parametrize(
    ("sequence", "state"),
    [
        ([error_frame(0x04, 0x08)], "error-warning"),
        ([error_frame(0x04, 0x20)], "error-passive"),
        ([error_frame(0x04, 0x10), error_frame(0x04, 0x40)], "error-active"),
        ([error_frame(0x04, 0x10), error_frame(0x08)], "error-passive"),
        ([error_frame(0x04, 0x10), error_frame(0x04, 0x01)], "error-passive"),
        ([error_frame(0x40)], "bus-off"),
        ([error_frame(0x40), error_frame(0x100)], "error-active"),
        ([error_frame(0x40), message(1)], "error-active"),
    ],
)
def test_controller_state_is_read_from_error_frames(sequence: list[can.Message], state: str) -> None:
    async def scenario() -> None:
        bus = SocketPairBus()
        bench = Bench(bus, ids=[FrameId(1)])
        task = asyncio.create_task(bench.link.run())
        for item in sequence:
            bus.put(item)
        await bench.wait_for(len(sequence))
        assert bench.link.controller_state == state
        assert bench.link.counters.error_frames == sum(item.is_error_frame for item in sequence)
        assert [frame.is_error for frame in bench.frames] == [item.is_error_frame for item in sequence]
        assert bench.link.state.startswith("waiting: test0 is bus-off" if state == "bus-off" else "running")
        await cancel(task)

    run(scenario())


def arrival_s(monkeypatch: pytest.MonkeyPatch, *ages_s: float) -> list[float]:
    """Monotonic arrival times of frames whose kernel stamps are `ages_s` old, read at 100 s."""
    monkeypatch.setattr(time, "time", lambda: 1_000_000.0)
    arrivals: list[float] = []

    async def scenario() -> None:
        bus = SocketPairBus()
        bench = Bench(bus, clock=VirtualClock(100_000_000_000))
        task = asyncio.create_task(bench.link.run())
        for age in ages_s:
            bus.put(message(1, timestamp=1_000_000.0 - age))
        await bench.wait_for(len(ages_s))
        await cancel(task)
        arrivals.extend(frame.t_ns / 1e9 for frame in bench.frames)

    run(scenario())
    return arrivals


@pytest.mark.parametrize(
    ("age_s", "expected_s"), [(0.0, 100.0), (0.02, 99.98), (0.2, 100.0), (-3600.0, 100.0), (1e6, 100.0)]
)
def test_kernel_time_is_used_unless_the_wall_clock_was_set(
    monkeypatch: pytest.MonkeyPatch, age_s: float, expected_s: float
) -> None:
    assert arrival_s(monkeypatch, age_s) == [pytest.approx(expected_s, abs=1e-6)]


def test_time_never_goes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    arrivals = arrival_s(monkeypatch, 0.03, 0.2, 0.01)
    assert arrivals == [pytest.approx(99.97), pytest.approx(100.0), pytest.approx(100.0)]
    assert arrivals == sorted(arrivals)


def test_sending_is_refused_while_listening_only() -> None:
    async def scenario() -> None:
        bus = SocketPairBus()
        bench = Bench(bus)
        task = asyncio.create_task(bench.link.run())
        await bench.opened.wait()
        assert not bench.link.send(Frame(1, 0x6F0, b"12345678"))
        await cancel(task)
        assert bus.sent == []
        assert "`listen_only` forbids" in bench.link.last_error
        assert (bench.link.counters.sent, bench.link.counters.send_failures) == (0, 1)

    run(scenario())


def test_sent_frames_and_failures_to_send_are_counted() -> None:
    async def scenario() -> None:
        bus = SocketPairBus()
        bench = Bench(bus, settings=SENDING)
        frame = Frame(1, 0x6F0, b"12345678")
        assert not bench.link.send(frame)
        assert "not opened yet" in bench.link.last_error
        task = asyncio.create_task(bench.link.run())
        await bench.opened.wait()
        assert bench.link.send(frame)
        bus.send_error = can.CanOperationError("Transmit buffer full")
        assert not bench.link.send(frame)
        assert bench.link.last_error == "socketcan test0: Transmit buffer full"
        assert not bench.link.send(Frame(1, 0x6F0, bytes(9)))  # no classic frame has 9 bytes
        assert bench.link.state == "running"
        await cancel(task)
        assert [(sent.arbitration_id, bytes(sent.data), sent.is_extended_id) for sent in bus.sent] == [
            (0x6F0, b"12345678", False)
        ]
        assert (bench.link.counters.sent, bench.link.counters.send_failures) == (1, 3)

    run(scenario())


def test_failure_to_close_is_reported_and_does_no_harm() -> None:
    class Stubborn(SocketPairBus):
        def shutdown(self) -> None:
            super().shutdown()
            raise can.CanError("stubborn")

    async def scenario() -> None:
        bench = Bench(Stubborn())
        task = asyncio.create_task(bench.link.run())
        await bench.opened.wait()
        await cancel(task)
        assert "stubborn" in bench.link.last_error
        assert bench.link.state == "waiting: closed"

    run(scenario())


def test_virtual_interface_is_polled() -> None:
    async def scenario() -> None:
        arrived = asyncio.Event()
        frames: list[Frame] = []

        def on_frame(frame: Frame) -> None:
            frames.append(frame)
            if len(frames) == 200:
                arrived.set()

        settings = CanSettings(interface="virtual", channel="polled", listen_only=False)
        link = CanBus(settings, on_frame, SystemClock(), [FrameId(5)])
        with can.Bus(interface="virtual", channel="polled", ignore_config=True) as peer:
            task = asyncio.create_task(link.run())
            while link.state != "running":
                await asyncio.sleep(0)
            for number in range(200):
                peer.send(can.Message(arbitration_id=5, data=[number], is_extended_id=False))
            await arrived.wait()
            assert link.send(Frame(1, 0x6F0, b"to all"))
            answer = peer.recv(20)
            assert answer is not None
            assert bytes(answer.data) == b"to all"
            await cancel(task)
        assert [frame.data[0] for frame in frames] == list(range(200))

    run(scenario())


def test_drain_reads_what_is_waiting_stamped_with_simulated_time() -> None:
    clock = VirtualClock(5_000)
    link = CanBus(CanSettings(interface="virtual", channel="drained"), nobody, clock, [FrameId(1), FrameId(2)])
    assert link.drain() == []
    with can.Bus(interface="virtual", channel="drained", ignore_config=True) as peer:
        for number in (1, 3, 2):
            peer.send(message(number))
        assert link.drain() == [Frame(5_000, 1, b"\x01"), Frame(5_000, 2, b"\x02")]
        assert link.counters.ignored == 1
        clock.sleep(1.0)
        peer.send(message(2))
        assert link.drain() == [Frame(1_000_005_000, 2, b"\x02")]
    link.close()


def test_drain_survives_a_bus_that_fails_and_opens_it_anew() -> None:
    first, second = SocketPairBus(), SocketPairBus()
    bench = Bench(first, OSError(errno.ENODEV, "No such device"), second, clock=VirtualClock(5))
    for item in (message(1), can.CanOperationError("Network is down"), message(2)):
        first.put(item)
    assert bench.link.drain() == [Frame(5, 1, b"\x01")]
    assert first.closed
    assert bench.link.state == "waiting: socketcan test0: Network is down"
    assert bench.link.drain() == []
    second.put(message(3))
    assert bench.link.drain() == [Frame(5, 3, b"\x03")]
    assert (bench.link.counters.failures, bench.link.counters.reconnects) == (2, 1)
    bench.link.close()
    assert second.closed


def multicast_settings(port: int) -> CanSettings:
    return CanSettings(interface="udp_multicast", channel=GROUP, port=port, listen_only=False)


def test_two_programs_meet_over_local_multicast() -> None:
    async def scenario() -> None:
        arrived = asyncio.Event()
        frames: list[Frame] = []

        def on_frame(frame: Frame) -> None:
            frames.append(frame)
            if len(frames) == 20:
                arrived.set()

        receiver = CanBus(multicast_settings(PORT), on_frame, SystemClock(), [FrameId(0x310)])
        sender = CanBus(multicast_settings(PORT), lambda frame: None, SystemClock())
        tasks = [asyncio.create_task(link.run()) for link in (receiver, sender)]
        for _ in range(10):
            await asyncio.sleep(0)
        if {receiver.state, sender.state} != {"running"}:
            pytest.fail(f"No multicast on this computer, the test needs it: {receiver.state}, {sender.state}")
        sent = [Frame(1, 0x310, bytes([number])) for number in range(20)]
        assert [sender.send(frame) for frame in sent] == [True] * 20
        try:
            await asyncio.wait_for(arrived.wait(), 20)
        except TimeoutError:
            pytest.fail(f"Multicast to {GROUP} does not come back on this computer, the test needs it.")
        for task in tasks:
            await cancel(task)
        assert [frame.data for frame in frames] == [frame.data for frame in sent]
        now_ns = time.monotonic_ns()
        assert all(0 <= now_ns - frame.t_ns < 60e9 for frame in frames)

    run(scenario())


def test_garbage_on_multicast_is_a_failure_that_passes() -> None:
    async def scenario() -> None:
        arrived = asyncio.Event()
        link = CanBus(multicast_settings(PORT + 1), lambda frame: arrived.set(), SystemClock())
        task = asyncio.create_task(link.run())
        for _ in range(10):
            await asyncio.sleep(0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as anyone:
            anyone.sendto(b"\xc1 no frame", (GROUP, PORT + 1))
            while not link.counters.failures:
                await asyncio.sleep(0.01)
            while link.state != "running":
                await asyncio.sleep(0.01)
        assert "could not unpack" in link.last_error
        assert link.send(Frame(1, 1, b"own"))  # multicast comes back to its sender
        await arrived.wait()
        await cancel(task)

    run(scenario())


def test_missing_network_interface_is_named_without_noise_in_the_log(
    no_waiting: list[float], caplog: pytest.LogCaptureFixture
) -> None:
    async def scenario() -> None:
        link = CanBus(CanSettings(channel="nocan7"), nobody, SystemClock())
        task = asyncio.create_task(link.run())
        while link.counters.failures < 5:
            await asyncio.sleep(0)
        await cancel(task)
        assert "nocan7: there is no network interface nocan7: plug it in" in link.last_error

    run(scenario())
    assert len(caplog.records) == 1


def test_interface_that_is_down_is_refused_with_the_command_that_helps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    require_interface_up("lo")
    monkeypatch.setattr(fcntl, "ioctl", lambda *request: struct.pack("16sh22x", b"can0", 0x80))
    with pytest.raises(OSError, match="can0 is down: ip link set can0 up") as refusal:
        require_interface_up("can0")
    assert refusal.value.errno == errno.ENETDOWN


def test_socketcan_gets_kernel_filters_for_exactly_the_wanted_identifiers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[dict[str, Any]] = []

    def fake(**options: Any) -> SocketPairBus:
        asked.append(options)
        return SocketPairBus()

    monkeypatch.setattr(can, "Bus", fake)
    settings = CanSettings(channel="lo")
    for ids in ([FrameId(0x310), FrameId(0x18FF00F7, True)], None):
        link = CanBus(settings, nobody, VirtualClock(), ids)
        link.drain()
        link.close()
    filters = sorted((entry["can_id"], entry["can_mask"], entry["extended"]) for entry in asked[0]["can_filters"])
    assert filters == [(0x310, 0x7FF, False), (0x18FF00F7, 0x1FFFFFFF, True)]
    assert asked[1]["can_filters"] is None
    assert all((options["channel"], options["fd"]) == ("lo", True) for options in asked)
