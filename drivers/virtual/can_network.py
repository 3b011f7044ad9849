"""A CAN network within one process: buses of one channel hear each other, and the interface can go wrong.

python-can's `virtual` bus has no file descriptor, so nothing tried on it runs the path of a real bus. This
one is a socket pair per bus: the kernel holds what has not been read, within bounds, and the event loop
waits on a descriptor. What a bus does while the interface is down, deleted or made anew is what python-can's
SocketCAN bus does on a vcan interface of Linux.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
import threading
import time
from collections import deque
from contextlib import suppress

import can

_HEADER = struct.Struct("=dIBB")  # time stamp, identifier with flags, data length code, flags
_LARGEST_PACKET = _HEADER.size + 64
_WAKE_UP = b""  # a packet that is no frame: makes the descriptor readable when an error is to be read

# Flags of the identifier (linux/can.h) and of FD frames
_EXTENDED, _REMOTE, _ERROR = 0x80000000, 0x40000000, 0x20000000
_BIT_RATE_SWITCH, _ERROR_STATE, _FD = 0x01, 0x02, 0x04

# Error classes (linux/can/error.h)
_BUS_OFF, _RESTARTED = 0x040, 0x100


class CanNetwork:
    """The interface that all buses of one channel share; `network` gives it."""

    def __init__(self, channel: str) -> None:
        self.channel = channel
        self._lock = threading.Lock()
        self._buses: list[NetworkBus] = []
        self._index = 1
        self._exists = True
        self._is_up = True
        self._is_bus_off = False
        self.received = 0  # data frames that came from others since the interface is there, read or not

    @property
    def index(self) -> int:
        """Number of the interface; one that is made anew has another."""
        return self._index

    @property
    def is_up(self) -> bool:
        """Whether frames may pass; put down, every open bus reads ENETDOWN once and then nothing."""
        return self._is_up and self._exists

    @is_up.setter
    def is_up(self, value: bool) -> None:
        if self.is_up and not value:
            self._raise_in_buses(errno.ENETDOWN)
        self._is_up = value

    @property
    def exists(self) -> bool:
        """Whether the interface is there; deleted, the buses then open are dead for ever. Made anew it is up."""
        return self._exists

    @exists.setter
    def exists(self, value: bool) -> None:
        if self._exists and not value:
            if self.is_up:
                self._raise_in_buses(errno.ENETDOWN)
            self._raise_in_buses(errno.ENODEV)
            with self._lock:
                self._buses.clear()
        elif value and not self._exists:
            self._index += 1
            self._is_up, self._is_bus_off, self.received = True, False, 0
        self._exists = value

    @property
    def is_bus_off(self) -> bool:
        """Whether the controller has left the bus: nothing is sent; beginning and end are told by error frames."""
        return self._is_bus_off

    @is_bus_off.setter
    def is_bus_off(self, value: bool) -> None:
        if value != self._is_bus_off:
            self._is_bus_off = value
            self.deliver(error_message(_BUS_OFF if value else _RESTARTED))

    def deliver(self, message: can.Message, sender: NetworkBus | None = None) -> None:
        """Give a message, error frames included, to every open bus but the sender's, as the driver would."""
        if not self.is_up:
            return
        packet = _packed(message)
        is_from_others = sender is None or not sender.is_own
        with self._lock:
            self.received += is_from_others and not message.is_error_frame
            for bus in self._buses:
                if bus is not sender:
                    bus.enqueue(packet)

    def add(self, bus: NetworkBus) -> None:
        """Let `bus` hear what passes from now on."""
        with self._lock:
            self._buses.append(bus)

    def remove(self, bus: NetworkBus) -> None:
        """Let `bus` hear nothing any more."""
        with self._lock:
            if bus in self._buses:
                self._buses.remove(bus)

    def _raise_in_buses(self, number: int) -> None:
        with self._lock:
            for bus in self._buses:
                bus.enqueue_error(number)


_networks: dict[str, CanNetwork] = {}


def network(channel: str) -> CanNetwork:
    """The one network of that name in this process."""
    return _networks.setdefault(channel, CanNetwork(channel))


class NetworkBus(can.BusABC):
    """One program's access to the network `channel`.

    Args:
        channel: name of the network.
        is_own: of the program whose interface this is, so that what it sends does not count as received.

    Raises:
        OSError: the interface does not exist (ENODEV).
    """

    def __init__(self, channel: str, *, is_own: bool = False) -> None:
        self.is_own = is_own
        self._network = network(channel)
        if not self._network.exists:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        self.channel_info = f"virtual network {channel}"
        self.lost = 0  # frames that did not fit into the receive buffer
        self._index = self._network.index
        self._errors: deque[int] = deque()
        self._near, self._far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._near.setblocking(False)
        self._far.setblocking(False)
        self._network.add(self)
        super().__init__(channel)

    def enqueue(self, packet: bytes) -> None:
        """Put a packet into the receive buffer; without room it is lost and counted."""
        try:
            self._far.send(packet)
        except BlockingIOError:
            self.lost += 1

    def enqueue_error(self, number: int) -> None:
        """Let the next `recv` raise; it goes before the frames that wait, as in the kernel."""
        self._errors.append(number)
        with suppress(BlockingIOError):  # full: readable already
            self._far.send(_WAKE_UP)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if timeout != 0 and not self._errors:
            select.select([self._near], [], [], timeout)
        if self._errors:
            number = self._errors.popleft()
            raise can.CanOperationError(f"Error receiving: {os.strerror(number)}", number)
        packet = _WAKE_UP
        while packet == _WAKE_UP:
            try:
                packet = self._near.recv(_LARGEST_PACKET)
            except BlockingIOError:
                return None, True
        return _unpacked(packet, self.channel_info), True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 (never waits)
        """Give a message to all others.

        Raises:
            can.CanOperationError: interface deleted (ENXIO), down (ENETDOWN) or bus-off (ENOBUFS).
        """
        number = self._refusal()
        if number:
            raise can.CanOperationError(f"Failed to transmit: {os.strerror(number)}", number)
        self._network.deliver(msg, self)

    def _refusal(self) -> int:
        if self._near.fileno() < 0:
            return errno.EBADF
        if not self._network.exists or self._network.index != self._index:
            return errno.ENXIO
        if not self._network.is_up:
            return errno.ENETDOWN
        return errno.ENOBUFS if self._network.is_bus_off else 0

    def fileno(self) -> int:
        """Readable whenever `recv` has something to give or to raise."""
        return self._near.fileno()

    def shutdown(self) -> None:
        """Leave the network."""
        super().shutdown()
        self._network.remove(self)
        self._near.close()
        self._far.close()


def error_message(error_class: int, data: bytes = bytes(8)) -> can.Message:
    """An error frame as the kernel makes it: class bits and detail bytes of linux/can/error.h."""
    return can.Message(arbitration_id=error_class, data=data, is_extended_id=False, is_error_frame=True)


def _packed(message: can.Message) -> bytes:
    identifier = message.arbitration_id
    identifier |= (
        _EXTENDED * message.is_extended_id | _REMOTE * message.is_remote_frame | _ERROR * message.is_error_frame
    )
    flags = (
        _FD * message.is_fd | _BIT_RATE_SWITCH * message.bitrate_switch | _ERROR_STATE * message.error_state_indicator
    )
    return _HEADER.pack(time.time(), identifier, message.dlc, flags) + message.data


def _unpacked(packet: bytes, channel: str) -> can.Message:
    timestamp, identifier, dlc, flags = _HEADER.unpack_from(packet)
    return can.Message(
        timestamp=timestamp,
        arbitration_id=identifier & 0x1FFFFFFF,
        is_extended_id=bool(identifier & _EXTENDED),
        is_remote_frame=bool(identifier & _REMOTE),
        is_error_frame=bool(identifier & _ERROR),
        is_fd=bool(flags & _FD),
        bitrate_switch=bool(flags & _BIT_RATE_SWITCH),
        error_state_indicator=bool(flags & _ERROR_STATE),
        dlc=dlc,
        data=packet[_HEADER.size :],
        channel=channel,
    )
