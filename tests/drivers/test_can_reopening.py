"""An interface that goes down, away, or silent without a word: the link notices, says so, and comes back."""

from __future__ import annotations

import errno
import fcntl
import socket
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from drivers.can import bus as bus_module
from drivers.can import interface as interface_module
from drivers.can.bus import CanBus
from drivers.can.frame import Frame, FrameId
from drivers.can.interface import InterfaceFault, InterfaceStatus, interface_status
from drivers.can.settings import CanSettings
from drivers.clock import SystemClock, VirtualClock
from drivers.condition import Wellness
from drivers.virtual.can_network import NetworkBus
from tests.drivers.can_bench import Bench, message, nobody, run


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Supervision and tries 50 times as often; the conditions are judged by the clock as ever."""
    monkeypatch.setattr(bus_module, "SUPERVISE_S", 0.02)
    monkeypatch.setattr(bus_module, "FIRST_BACKOFF_S", 0.002)
    monkeypatch.setattr(bus_module, "LONGEST_BACKOFF_S", 0.02)


def test_interface_put_down_and_up_again() -> None:
    async def scenario() -> None:
        async with Bench(listen_only=False) as bench:
            channel = bench.settings.channel
            bench.network.is_up = False
            await bench.until(lambda: bench.link.counters.failures >= 3)
            condition = bench.link.condition
            assert condition.word is Wellness.WAITING
            assert condition.what == f"virtual {channel}: network interface {channel} is down"
            assert condition.advice == f"ip link set {channel} up"
            assert not bench.link.send(Frame(1, 1, b""))
            assert bench.link.counters.send_failures == 1
            bench.network.is_up = True
            await bench.until(lambda: bench.link.counters.reconnects == 1)
            bench.peer.send(message(1))
            await bench.frames_come(1)
            assert bench.link.send(Frame(1, 1, b""))
            assert bench.link.condition.what == ""

    run(scenario())


def test_interface_deleted_and_made_anew() -> None:
    async def scenario() -> None:
        async with Bench() as bench:
            bench.network.exists = False
            await bench.until(lambda: "there is no network interface" in bench.link.condition.what)
            assert "plug it in" in bench.link.condition.advice
            bench.network.exists = True
            await bench.until(lambda: bench.link.counters.reconnects == 1)
            with NetworkBus(bench.settings.channel) as peer:
                peer.send(message(1))
                await bench.frames_come(1)

    run(scenario())


class DeafBus(NetworkBus):
    """A bus to which nothing tells that its interface has gone: the socket that never says a word."""

    def enqueue_error(self, number: int) -> None:
        """Nothing."""


@pytest.mark.parametrize(
    ("event", "words"), [("down", "is down"), ("deleted", "there is no"), ("anew", "deleted and made anew")]
)
def test_silent_death_of_the_socket_is_noticed(event: str, words: str) -> None:
    async def scenario() -> None:
        async with Bench(opener=lambda settings, ids: DeafBus(settings.channel)) as bench:
            if event == "down":
                bench.network.is_up = False
            else:
                bench.network.exists = False
            if event == "anew":
                bench.network.exists = True
            await bench.until(lambda: bench.link.counters.failures > 0)
            assert words in bench.link.last_error
            bench.network.exists = bench.network.is_up = True
            await bench.until(lambda: bench.link.counters.reconnects == 1)
            with NetworkBus(bench.settings.channel) as peer:
                peer.send(message(1))
                await bench.frames_come(1)

    run(scenario())


def test_silent_death_is_noticed_in_simulated_time_too() -> None:
    clock = VirtualClock()
    bench = Bench(clock=clock, opener=lambda settings, ids: DeafBus(settings.channel))
    bench.link.drain()
    bench.network.is_up = False
    for _ in range(20):
        clock.sleep(0.1)
        assert bench.link.drain() == []
    assert "is down" in bench.link.condition.what
    bench.network.is_up = True
    clock.sleep(5.0)
    bench.link.drain()
    bench.peer.send(message(1))
    assert [frame.arbitration_id for frame in bench.link.drain()] == [1]
    bench.link.close()


def test_progress_goes_on_whether_the_bus_is_silent_or_missing() -> None:
    async def scenario() -> None:
        async with Bench() as bench:
            for missing in (False, True):
                bench.network.exists = not missing
                before = bench.link.progress
                await bench.until(lambda before=before: bench.link.progress >= before + 5)  # type: ignore[misc]

    run(scenario())


def test_network_bus_whose_controller_is_bus_off_already_when_it_is_opened() -> None:
    clock = VirtualClock()
    bench = Bench(clock=clock)
    bench.network.is_bus_off = True
    for _ in range(3):
        bench.link.drain()
        clock.sleep(1.0)
    assert bench.link.counters.error_frames == 0
    assert bench.link.controller_state == "bus-off"
    assert "is bus-off" in bench.link.condition.what
    assert "restart-ms" in bench.link.condition.advice
    bench.network.is_bus_off = False
    bench.link.drain()
    clock.sleep(1.0)
    bench.link.drain()
    assert bench.link.controller_state == "error-active"
    bench.link.close()


# --- the kernel's own interfaces ------------------------------------------------------------------------------


def test_missing_network_interface_is_named_without_noise_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    clock = VirtualClock()
    link = CanBus(CanSettings(channel="nocan7"), nobody, clock)
    for _ in range(50):
        link.drain()
        clock.sleep(0.1)
    assert link.counters.failures >= 5
    assert link.condition.what == "socketcan nocan7: there is no network interface nocan7"
    assert link.condition.advice.startswith("plug it in")
    assert not caplog.records  # python-can would complain at every try


def kernel_says(monkeypatch: pytest.MonkeyPatch, flags: int, index: int = 3) -> None:
    """The answers of the kernel about the interface can0."""
    monkeypatch.setattr(fcntl, "ioctl", lambda *request: struct.pack("16sH22x", b"can0", flags))
    monkeypatch.setattr(socket, "if_nametoindex", lambda name: index)


def test_interface_that_is_down_is_refused_with_the_command_that_helps(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert interface_status(CanSettings(channel="lo")).index == socket.if_nametoindex("lo")
    kernel_says(monkeypatch, 0x80)
    with pytest.raises(InterfaceFault, match=r"can0 is down: ip link set can0 up$") as refusal:
        interface_status(CanSettings(channel="can0"))
    assert refusal.value.errno == errno.ENETDOWN
    monkeypatch.setattr(interface_module, "_NETWORK", str(tmp_path))
    (tmp_path / "can0" / "device").mkdir(parents=True)
    with pytest.raises(InterfaceFault, match="the first time: ip link set can0 up type can bitrate 250000"):
        interface_status(CanSettings(channel="can0"))


def test_interface_without_carrier_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel_says(monkeypatch, 0x81)  # up, not running
    assert interface_status(CanSettings(channel="can0")) == InterfaceStatus(3, is_running=False, receives_own=True)
    kernel_says(monkeypatch, 0xC1)
    assert interface_status(CanSettings(channel="can0")) == InterfaceStatus(3, receives_own=True)


def counting_kernel(
    monkeypatch: pytest.MonkeyPatch, folder: Path, *, has_controller: bool = True
) -> Callable[[int], None]:
    """The interface can0 with its statistics; tells how many frames it has received."""
    monkeypatch.setattr(interface_module, "_NETWORK", str(folder))
    kernel_says(monkeypatch, 0xC1)
    (folder / "can0" / "statistics").mkdir(parents=True)
    if has_controller:
        (folder / "can0" / "device").mkdir()

    def count(frames: int) -> None:
        (folder / "can0" / "statistics" / "rx_packets").write_text(f"{frames}\n")

    return count


@pytest.mark.parametrize(
    ("has_controller", "foreign", "what"),
    [
        (False, 0, "no frame at all for 9 s although can0 is up"),
        (False, 1, "frames arrive on can0, but none with the wanted identifier 0x310 for 9 s"),
        (True, 1, "frames arrive on can0, but none with the wanted identifier 0x310 for 9 s"),
    ],
)
def test_own_frames_do_not_count_as_received(
    has_controller: bool, foreign: int, what: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A virtual interface counts what is sent on it as received; each second ten own frames and one or no other."""
    kernel_counts = counting_kernel(monkeypatch, tmp_path, has_controller=has_controller)
    clock = VirtualClock()
    settings = CanSettings(channel="can0", listen_only=False)
    link = CanBus(settings, nobody, clock, [FrameId(0x310)], opener=lambda settings, ids: NetworkBus("none"))
    received = 0
    for _ in range(10):
        kernel_counts(received)
        link.drain()
        said = link.condition.what
        for _ in range(10):
            assert link.send(Frame(1, 0x6F0, bytes(8)))
        received += foreign + (0 if has_controller else 10)
        clock.sleep(1.0)
    assert said == what
    link.close()


def test_frames_that_a_listen_only_controller_drops_are_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The kernel takes them without an error."""
    counting_kernel(monkeypatch, tmp_path)(0)
    dropped = tmp_path / "can0" / "statistics" / "tx_dropped"
    dropped.write_text("30\n")
    clock = VirtualClock()
    settings = CanSettings(channel="can0", listen_only=False)
    link = CanBus(settings, nobody, clock, opener=lambda settings, ids: NetworkBus("none"))
    link.drain()
    for count in (30, 40, 50):
        dropped.write_text(f"{count}\n")
        clock.sleep(1.0)
        link.drain()
    assert link.condition.what == "can0 dropped 20 frames that were to be sent in the last 10 s: is it listen-only?"
    assert "type can listen-only off" in link.condition.advice
    link.close()


def test_frames_that_the_kernel_filter_holds_back_are_seen_in_the_statistics(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    kernel_counts = counting_kernel(monkeypatch, tmp_path)
    clock = VirtualClock()
    link = CanBus(
        CanSettings(channel="can0"), nobody, clock, [FrameId(0x310)], opener=lambda settings, ids: NetworkBus("none")
    )
    for second in range(10):
        kernel_counts(second * 100)
        link.drain()
        clock.sleep(1.0)
    assert "none with the wanted identifier 0x310" in link.condition.what
    assert "candump can0" in link.condition.advice
    for _ in range(10):
        link.drain()
        clock.sleep(1.0)
    assert link.condition.what == "no frame at all for 11 s although can0 is up"
    link.close()


def test_new_interface_of_the_same_name_is_noticed_on_a_kernel_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel_says(monkeypatch, 0xC1, index=3)
    clock = VirtualClock()
    link = CanBus(CanSettings(channel="can0"), nobody, clock, opener=lambda settings, ids: NetworkBus("none"))
    link.drain()
    kernel_says(monkeypatch, 0xC1, index=4)
    clock.sleep(1.0)
    link.drain()
    assert "deleted and made anew" in link.condition.what
    clock.sleep(0.1)
    link.drain()
    assert link.counters.reconnects == 1
    link.close()


def test_lack_of_descriptors_to_ask_with_is_no_reason_to_give_up_a_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = VirtualClock()
    link = CanBus(CanSettings(channel="lo"), nobody, clock, opener=lambda settings, ids: NetworkBus("none"))
    link.drain()

    def no_descriptor(*request: Any) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(socket, "socket", no_descriptor)
    clock.sleep(1.0)
    link.drain()
    assert (link.counters.failures, link.progress) == (0, 1)
    link.close()


def test_socketcan_gets_kernel_filters_for_exactly_the_wanted_identifiers(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, Any]] = []

    def fake(**options: Any) -> can.BusABC:
        asked.append(options)
        return NetworkBus("none")

    monkeypatch.setattr(can, "Bus", fake)
    for ids in ([FrameId(0x310), FrameId(0x18FF00F7, True)], None):
        link = CanBus(CanSettings(channel="lo"), nobody, SystemClock(), ids)
        link.drain()
        link.close()
    filters = sorted((entry["can_id"], entry["can_mask"], entry["extended"]) for entry in asked[0]["can_filters"])
    assert filters == [(0x310, 0x7FF, False), (0x18FF00F7, 0x1FFFFFFF, True)]
    assert asked[1]["can_filters"] is None
    assert all((options["channel"], options["fd"]) == ("lo", True) for options in asked)
