"""The virtual sensor for another process: SPI frames and data-ready edges over a Unix socket.

Every message has a length (2 bytes, big-endian) in front. A connection opens with a greeting that says
what it carries: frames (request: speed [Hz], 4 bytes, time of the request [ns], 8 bytes, then the data; answer:
as many bytes, none if the port failed) or edges of one pin (time [ns] and lost edges, 8 bytes each, sent as
they happen). Times are CLOCK_MONOTONIC, which all processes share: the part answers as of the request, so that
the way from process to process, which no wire has, tears no burst.
"""

from __future__ import annotations

import contextlib
import logging
import os
import select
import socket
import stat
import struct
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from drivers.data_ready import DataReadyError, Edge
from drivers.spi import SpiError
from estimation.records import TimeKind

if TYPE_CHECKING:
    from drivers.virtual.part import VirtualPart

_LENGTH = struct.Struct(">H")
_GREETING = struct.Struct(">cBB")  # kind, pin, active high
_REQUEST = struct.Struct(">Iq")  # speed, time
_EDGE = struct.Struct(">qq")
_FRAMES, _EDGES = b"F", b"E"
_LONGEST_FRAME = 4096  # bytes, as the kernel's spidev allows by default
_POLL_S = 0.1  # how soon a stop is noticed
_PATIENCE_S = 2.0  # a local partner that needs longer is dead

_log = logging.getLogger(__name__)


def _receive_exactly(connection: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        piece = connection.recv(count - len(data))
        if not piece:
            raise EOFError
        data += piece
    return data


def _receive(connection: socket.socket) -> bytes:
    (length,) = _LENGTH.unpack(_receive_exactly(connection, _LENGTH.size))
    return _receive_exactly(connection, length)


def _send(connection: socket.socket, message: bytes) -> None:
    connection.sendall(_LENGTH.pack(len(message)) + message)


@dataclass(slots=True)
class Served:
    """What clients got so far."""

    frames: int = 0
    failed_frames: int = 0  # the port failed, as a fault script says
    edges: int = 0  # told, those that a late listener counts as missed included


class SpiSocketServer:
    """Serves one virtual part at `path`, a thread per connection, from `start` to `close`.

    Raises SpiError if the path cannot be served.
    """

    def __init__(self, path: str, part: VirtualPart) -> None:
        self.served = Served()
        self._path = path
        self._part = part
        self._counting = threading.Lock()
        self._bus = threading.Lock()  # one SPI port, however many clients
        self._stopping = threading.Event()
        self._connections: set[socket.socket] = set()
        self._acceptor = threading.Thread(target=self._accept, name="spi socket", daemon=True)
        self._servers: list[threading.Thread] = []
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            _remove_stale(path)
            self._listener.bind(path)
            self._listener.listen()
        except OSError as error:
            self._listener.close()
            if isinstance(error, SpiError):
                raise
            raise SpiError(f"cannot serve the virtual sensor at {path}: {error.strerror or error}") from error
        self._inode = os.stat(path).st_ino

    def start(self) -> None:
        """Accept clients."""
        self._acceptor.start()

    def close(self) -> None:
        """Hang up on every client, end the threads, remove the socket file."""
        self._stopping.set()
        if self._acceptor.ident is not None:
            self._acceptor.join()
        for connection in list(self._connections):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        for thread in self._servers:
            thread.join()
        self._listener.close()
        with contextlib.suppress(OSError):
            if os.stat(self._path).st_ino == self._inode:
                os.unlink(self._path)

    def _accept(self) -> None:
        while not self._stopping.is_set():
            if not select.select([self._listener], [], [], _POLL_S)[0]:
                continue
            connection, _ = self._listener.accept()
            self._connections.add(connection)
            server = threading.Thread(target=self._serve, args=(connection,), name="spi client", daemon=True)
            self._servers = [old for old in self._servers if old.is_alive()] + [server]
            server.start()

    def _serve(self, connection: socket.socket) -> None:
        try:
            with connection:
                kind, pin, active_high = _GREETING.unpack(_receive(connection))
                if kind == _FRAMES:
                    self._serve_frames(connection)
                elif kind == _EDGES and pin in (1, 2):
                    self._serve_edges(connection, 1 if pin == 1 else 2, bool(active_high))
                else:
                    raise ValueError("unknown greeting")
        except (OSError, EOFError):
            pass  # the client left; it may come again
        except (ValueError, struct.error) as error:
            _log.warning("hung up on a client of %s that does not speak the protocol: %s", self._path, error)
        finally:
            self._connections.discard(connection)

    def _serve_frames(self, connection: socket.socket) -> None:
        while not self._stopping.is_set():
            request = _receive(connection)
            speed_hz, asked_ns = _REQUEST.unpack_from(request)
            data = request[_REQUEST.size :]
            if not speed_hz or not 0 < len(data) <= _LONGEST_FRAME:
                raise ValueError(f"a frame of {len(data)} bytes at {speed_hz} Hz")
            with self._bus:
                self.served.frames += 1
                try:
                    answer = self._part.transfer(data, speed_hz, asked_ns)
                except SpiError:
                    self.served.failed_frames += 1
                    answer = b""
            _send(connection, answer)

    def _serve_edges(self, connection: socket.socket, pin: Literal[1, 2], active_high: bool) -> None:
        line = self._part.data_ready(pin=pin, active_high=active_high)
        while not self._stopping.is_set():
            edge = line.wait(_POLL_S)
            if edge is not None:
                _send(connection, _EDGE.pack(edge.t_ns, edge.missed))
                with self._counting:
                    self.served.edges += 1 + edge.missed
            elif select.select([connection], [], [], 0)[0] and not connection.recv(1):
                return  # the client left while the line was silent


def _remove_stale(path: str) -> None:
    """Remove the socket file of a server that is gone."""
    try:
        if not stat.S_ISSOCK(os.stat(path).st_mode):
            raise SpiError(f"{path} exists and is no socket: choose another path for the virtual sensor")
    except FileNotFoundError:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(path)
        except ConnectionRefusedError:
            os.unlink(path)
            return
    raise SpiError(f"{path} is served by another program: stop it or choose another path")


def _connect(path: str, greeting: bytes, error_type: type[SpiError] | type[DataReadyError]) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.settimeout(_PATIENCE_S)
        connection.connect(path)
        _send(connection, greeting)
    except OSError as error:
        connection.close()
        raise error_type(
            f"no virtual sensor answers at {path} ({error.strerror or error}): start `ramstroke sim` first"
        ) from error
    return connection


class SocketTransport:
    """SPI frames to the part served at `path`. Raises SpiError."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._connection = _connect(path, _GREETING.pack(_FRAMES, 0, 0), SpiError)

    def transfer(self, data: bytes, speed_hz: int) -> bytes:
        """Exchange one frame."""
        try:
            _send(self._connection, _REQUEST.pack(speed_hz, time.monotonic_ns()) + data)
            answer = _receive(self._connection)
        except (OSError, EOFError) as error:
            self.close()  # a late answer must not be taken for that of the next frame
            raise SpiError(f"the virtual sensor at {self._path} is gone: start `ramstroke sim` again") from error
        if not answer:
            raise SpiError(f"the SPI port of the virtual sensor at {self._path} failed, as its fault script says")
        return answer

    def close(self) -> None:
        """Hang up."""
        self._connection.close()


class SocketDataReady:
    """Edges of the part served at `path`. Raises DataReadyError."""

    def __init__(self, path: str, *, pin: Literal[1, 2] = 1, active_high: bool = True) -> None:
        self._path = path
        self._connection = _connect(path, _GREETING.pack(_EDGES, pin, active_high), DataReadyError)
        self._buffer = b""

    def wait(self, timeout_s: float) -> Edge | None:
        """Wait for an edge and return the newest one; older ones still queued count as missed."""
        message_size = _LENGTH.size + _EDGE.size
        deadline = time.monotonic() + timeout_s
        try:
            while True:
                left = max(0.0, deadline - time.monotonic())
                if not select.select([self._connection], [], [], left)[0]:
                    return None
                piece = self._connection.recv(1 << 16)
                if not piece:
                    raise EOFError
                self._buffer += piece
                whole = len(self._buffer) // message_size
                if whole:
                    break
        except (OSError, EOFError) as error:
            raise DataReadyError(f"the virtual sensor at {self._path} is gone: start `ramstroke sim` again") from error
        edges = [_EDGE.unpack_from(self._buffer, i * message_size + _LENGTH.size) for i in range(whole)]
        self._buffer = self._buffer[whole * message_size :]
        return Edge(edges[-1][0], TimeKind.EDGE, whole - 1 + sum(missed for _, missed in edges))

    def close(self) -> None:
        """Hang up."""
        self._connection.close()
