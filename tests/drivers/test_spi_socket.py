from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.adis16448.burst import Burst, Fault
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.device import Adis16448
from drivers.clock import SystemClock
from drivers.data_ready import DataReadyError, Edge
from drivers.spi import SpiError
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.faulty_line import FaultyEdges
from drivers.virtual.inertial_input import RecordedInput, SteadyInput
from drivers.virtual.spi_socket import SocketDataReady, SocketTransport, SpiSocketServer
from estimation.records import TimeKind
from tests.drivers.fault_kit import fault, script


@contextlib.contextmanager
def served(path: Path, twin: Any) -> Iterator[SpiSocketServer]:
    server = SpiSocketServer(str(path), twin)
    server.start()
    try:
        yield server
    finally:
        server.close()
        assert not {t for t in threading.enumerate() if t.name.startswith("spi")}


def still_part() -> VirtualAdis16448:
    return VirtualAdis16448(SteadyInput(duration_s=0.0), SystemClock())


def test_a_driver_in_another_thread_reads_over_the_socket_what_the_edges_announce(tmp_path: Path) -> None:
    clock = SystemClock()
    start_ns = clock.now_ns()
    period_ns = 1e9 / 400  # slow: a loaded machine must be able to keep up now and then
    count = 4000
    numbers = np.arange(1, count + 1)
    column = np.repeat(numbers[:, np.newaxis], 3, axis=1)
    ramp = RecordedInput(
        start_ns + np.rint(numbers * period_ns).astype(np.int64),
        column * np.radians(0.04),
        column * 9.80665 / 1200,
    )
    path = tmp_path / "imu.sock"
    with served(path, VirtualAdis16448(ramp, clock)):
        transport = SocketTransport(str(path))
        device = Adis16448(transport, clock, ImuSettings(gyro_range_dps=1000, filter_taps_exponent=0))
        device.reset()
        clock.sleep(0.1)
        identity = device.identify()
        device.configure()
        line = SocketDataReady(str(path))
        pairs: list[tuple[int, Burst]] = []
        seen = 0
        for _ in range(60):
            edge = line.wait(5.0)
            assert edge is not None
            assert edge.kind is TimeKind.EDGE
            number = (edge.t_ns - start_ns) / period_ns
            assert number == pytest.approx(round(number), abs=1e-5)
            if pairs:
                assert round(number) == seen + 1 + edge.missed
            seen = round(number)
            pairs.append((round(number), device.read_burst(edge.t_ns, edge.kind)))
        transport.close()
        line.close()
    assert identity.product_id == 16448
    good = [(number, burst.words[1]) for number, burst in pairs if burst.fault is Fault.NONE]
    late = [word - number for number, word in good]
    assert min(late) == 0  # the burst belongs to the edge, but for a reader that was held up
    assert not path.exists()


class FakeLine:
    """Edges from a list, then silence; tells when the last one has been sent."""

    def __init__(self, edges: list[Edge]) -> None:
        self.edges = edges
        self.all_sent = threading.Event()

    def wait(self, timeout_s: float) -> Edge | None:
        if self.edges:
            return self.edges.pop(0)
        self.all_sent.set()
        threading.Event().wait(0.01)
        return None


class FakePart:
    """Echoes frames; has one line."""

    def __init__(self, edges: list[Edge] | None = None) -> None:
        self.line = FakeLine(edges or [])
        self.asked: list[tuple[int, bool]] = []
        self.asked_ns: list[int | None] = []
        self.is_port_broken = False

    def transfer(self, data: bytes, speed_hz: int, asked_ns: int | None = None) -> bytes:
        self.asked_ns.append(asked_ns)
        if self.is_port_broken:
            raise SpiError("broken")
        return bytes(byte ^ 0xFF for byte in data)

    def data_ready(self, *, pin: int, active_high: bool) -> FakeLine:
        self.asked.append((pin, active_high))
        return self.line


def test_queued_edges_collapse_to_the_newest_and_the_others_are_missed(tmp_path: Path) -> None:
    part = FakePart([Edge(t, TimeKind.EDGE, missed) for t, missed in ((100, 0), (200, 3), (300, 0))])
    with served(tmp_path / "s", part):
        line = SocketDataReady(str(tmp_path / "s"), pin=2, active_high=False)
        assert part.line.all_sent.wait(20)
        assert line.wait(5.0) == Edge(300, TimeKind.EDGE, 5)
        assert line.wait(0.0) is None
        assert part.asked == [(2, False)]
        part.line.edges.append(Edge(-5, TimeKind.EDGE, 0))
        assert line.wait(20.0) == Edge(-5, TimeKind.EDGE, 0)
        line.close()


def test_an_edge_cut_in_two_by_the_socket_is_put_together(tmp_path: Path) -> None:
    path = str(tmp_path / "s")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen()
        line = SocketDataReady(path)
        server, _ = listener.accept()
        with server:
            message = struct.pack(">Hqq", 16, 42, 1)
            server.sendall(message + message[:5])
            assert line.wait(5.0) == Edge(42, TimeKind.EDGE, 1)
            assert line.wait(0.01) is None
            server.sendall(message[5:])
            assert line.wait(5.0) == Edge(42, TimeKind.EDGE, 1)
        line.close()


def test_frames_go_there_and_back_for_several_clients(tmp_path: Path) -> None:
    with served(tmp_path / "s", FakePart()):
        clients = [SocketTransport(str(tmp_path / "s")) for _ in range(3)]
        for length in (2, 3, 28, 4096):
            for client in clients:
                assert client.transfer(bytes(length), 1_000_000) == b"\xff" * length
        for client in clients:
            client.close()


def test_a_port_that_fails_fails_for_the_client_and_works_again(tmp_path: Path) -> None:
    part = FakePart()
    with served(tmp_path / "s", part) as server:
        client = SocketTransport(str(tmp_path / "s"))
        part.is_port_broken = True
        for _ in range(2):
            with pytest.raises(SpiError, match="failed, as its fault script says"):
                client.transfer(b"\x56\x00", 1_000_000)
        part.is_port_broken = False
        assert client.transfer(b"\x56\x00", 1_000_000) == b"\xa9\xff"
        assert (server.served.frames, server.served.failed_frames) == (3, 2)
        client.close()


def test_a_request_says_when_it_was_made(tmp_path: Path) -> None:
    part = FakePart()
    with served(tmp_path / "s", part):
        client = SocketTransport(str(tmp_path / "s"))
        before_ns = time.monotonic_ns()
        client.transfer(b"\0\0", 1_000_000)
        client.close()
    (asked_ns,) = part.asked_ns
    assert asked_ns is not None
    assert before_ns <= asked_ns <= time.monotonic_ns()


def test_told_edges_are_counted_with_the_missed_ones(tmp_path: Path) -> None:
    part = FakePart([Edge(t, TimeKind.EDGE, missed) for t, missed in ((100, 0), (200, 3), (300, 0))])
    with served(tmp_path / "s", part) as server:
        line = SocketDataReady(str(tmp_path / "s"))
        assert part.line.all_sent.wait(20)
        assert server.served.edges == 6
        line.close()


def test_edges_lost_doubled_and_late_by_script_reach_the_client_so(tmp_path: Path) -> None:
    clock = SystemClock()
    start_ns = clock.now_ns()
    faults = script(
        fault("data_ready_lost", 0.0, 3600.0, share=0.3),
        fault("data_ready_doubled", 0.0, 3600.0, share=0.3, after_us=500),
        fault("late_edges", 0.0, 3600.0, every_ms=50.0),
    )
    wires = FaultyEdges(faults, start_ns)
    part = VirtualAdis16448(SteadyInput(500.0, start_ns=start_ns), clock, edge_wire=wires)
    with served(tmp_path / "s", part) as server:
        line = SocketDataReady(str(tmp_path / "s"))
        edges = [line.wait(5.0) for _ in range(4)]
        line.close()
    heard = 0
    for edge in edges:
        assert edge is not None
        heard += 1 + edge.missed
        number, echo = divmod(edge.t_ns - start_ns, 2_000_000)
        assert echo in (0, 500_000)
        assert wires.arrivals(start_ns + number * 2_000_000)
    # Bunches of 25 edges: 0.7 * 1.3 of them arrive.
    assert heard > 3 * 12
    assert server.served.edges >= heard
    account = part.account()
    assert account.edges + account.edges_lost_by_script - account.edges_added_by_script <= account.updates


@pytest.mark.parametrize(("client", "error"), [(SocketTransport, SpiError), (SocketDataReady, DataReadyError)])
def test_without_a_server_the_client_says_what_to_start(tmp_path: Path, client: Any, error: type[Exception]) -> None:
    path = str(tmp_path / "nobody.sock")
    with pytest.raises(error, match=r"nobody\.sock .*start `ramstroke sim` first"):
        client(path)


def test_a_server_that_ends_is_missed_at_once_and_for_good(tmp_path: Path) -> None:
    path = str(tmp_path / "s")
    with served(tmp_path / "s", FakePart()):
        transport, line = SocketTransport(path), SocketDataReady(path)
        assert transport.transfer(b"\0\0", 1) == b"\xff\xff"
    for _ in range(2):
        with pytest.raises(SpiError, match=r"is gone: start `ramstroke sim` again"):
            transport.transfer(b"\0\0", 1)
    with pytest.raises(DataReadyError, match=r"is gone: start `ramstroke sim` again"):
        line.wait(20.0)
    line.close()


def test_a_client_that_leaves_during_silence_is_let_go(tmp_path: Path) -> None:
    part = FakePart()
    with served(tmp_path / "s", part) as server:
        SocketDataReady(str(tmp_path / "s")).close()
        transport = SocketTransport(str(tmp_path / "s"))
        for _ in range(500):
            transport.transfer(b"\0\0", 1)
            if len(server._connections) == 1:
                break
            threading.Event().wait(0.01)
        assert len(server._connections) == 1
        transport.close()


@pytest.mark.parametrize(
    "message",
    [
        struct.pack(">HcBB", 3, b"X", 1, 1),
        struct.pack(">HcBB", 3, b"E", 3, 1),
        struct.pack(">H", 1) + b"F",
        struct.pack(">HcBB", 3, b"F", 0, 0) + struct.pack(">HIq", 12, 1_000_000, 0),
        struct.pack(">HcBB", 3, b"F", 0, 0) + struct.pack(">HIqH", 14, 0, 0, 0),
        struct.pack(">HcBB", 3, b"F", 0, 0) + struct.pack(">H", 0),
        struct.pack(">HcBB", 3, b"F", 0, 0) + struct.pack(">HIq", 4109, 1_000_000, 0) + bytes(4097),
    ],
)
def test_a_client_that_speaks_another_language_is_hung_up_on_and_others_are_served(
    tmp_path: Path, message: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    with served(tmp_path / "s", FakePart()):
        with socket.socket(socket.AF_UNIX) as stranger:
            stranger.settimeout(20)
            stranger.connect(str(tmp_path / "s"))
            stranger.sendall(message)
            with contextlib.suppress(ConnectionResetError):
                assert stranger.recv(1) == b""
        good = SocketTransport(str(tmp_path / "s"))
        assert good.transfer(b"\x01", 1) == b"\xfe"
        good.close()
    assert "does not speak the protocol" in caplog.text


def test_the_socket_file_of_a_dead_server_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    assert path.exists()
    with served(path, still_part()):
        SocketTransport(str(path)).close()
    assert not path.exists()


def test_a_path_in_use_a_plain_file_or_a_missing_folder_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with served(path, FakePart()), pytest.raises(SpiError, match="is served by another program"):
        SpiSocketServer(str(path), still_part())
    path.write_text("precious")
    with pytest.raises(SpiError, match="exists and is no socket"):
        SpiSocketServer(str(path), still_part())
    assert path.read_text() == "precious"
    with pytest.raises(SpiError, match=r"cannot serve the virtual sensor at .*No such file or directory"):
        SpiSocketServer(str(tmp_path / "missing" / "s"), still_part())


def test_a_closing_server_leaves_the_file_of_its_successor(tmp_path: Path) -> None:
    path = tmp_path / "s"
    first = SpiSocketServer(str(path), still_part())
    path.rename(tmp_path / "moved")
    with served(path, FakePart()):
        first.close()
        SocketTransport(str(path)).close()
