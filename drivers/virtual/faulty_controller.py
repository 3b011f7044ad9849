"""What a fault script does to the frames of the virtual controller and to their bus."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

from drivers.can.frame import Frame, FrameId
from drivers.virtual.can_network import CanNetwork
from drivers.virtual.faults import (
    BusOff,
    CanError,
    CanSilence,
    Corrupted,
    ErrorFrames,
    FaultScript,
    Flood,
    FrameFault,
    FrozenFrame,
    InterfaceDeleted,
    InterfaceDown,
    Placed,
    WrongIdentifier,
    WrongLength,
    placed,
)

# linux/can/error.h: class bits and the data bytes that say more.
_CONTROLLER, _PROTOCOL, _BUS_OFF, _BUS_ERROR, _RESTARTED = 0x004, 0x008, 0x040, 0x080, 0x100
_ERRORS: dict[CanError, tuple[int, dict[int, int]]] = {
    "warning": (_CONTROLLER, {1: 0x04}),
    "passive": (_CONTROLLER, {1: 0x10}),
    "overflow": (_CONTROLLER, {1: 0x01}),
    "bit_stuffing": (_PROTOCOL | _BUS_ERROR, {2: 0x04}),
    "no_acknowledge": (0x020, {}),
    "lost_arbitration": (0x002, {}),
}
_ERROR_ACTIVE = (_CONTROLLER, {1: 0x40})

_LAST_READING = b"to be filled in"


class FrameSource(Protocol):
    """Frames that become due."""

    @property
    def next_t_ns(self) -> int | None:
        """When something is due next, None after the last."""

    def due(self, t_ns: int) -> list[Frame]:
        """The frames due by `t_ns` that were not returned before."""


class FaultyController:
    """A FrameSource: the controller's frames with the faults of the script.

    Args:
        controller: the healthy source.
        script: what goes wrong.
        start_ns: start of the simulation.
        reading_id: identifier of the displacement frame, which the faults of single frames meet.
        bystander_id: identifier of a sender that is not the controller.
        network: the virtual interface, for faults that take it away.
    """

    def __init__(
        self,
        controller: FrameSource,
        script: FaultScript,
        start_ns: int,
        *,
        reading_id: FrameId,
        bystander_id: FrameId,
        network: CanNetwork | None = None,
    ) -> None:
        self._controller = controller
        self._reading_id = reading_id
        self._bystander_id = bystander_id
        self._network = network
        self._frozen: dict[bytes, bytes] = {}
        faults: list[Placed[FrameFault]] = placed(
            script, start_ns, CanSilence, WrongIdentifier, WrongLength, Corrupted, FrozenFrame
        )
        self._faults = [(place, place.generator()) for place in faults]
        self._bus_off = placed(script, start_ns, BusOff)
        self._down = placed(script, start_ns, InterfaceDown)
        self._deleted = placed(script, start_ns, InterfaceDeleted)
        interface: list[tuple[int, int]] = [(place.start_ns, place.end_ns) for place in self._down]
        interface += [(place.start_ns, place.end_ns) for place in self._deleted]
        self._interface_changes = deque(sorted({t_ns for window in interface for t_ns in window}))
        senders: list[Iterator[Frame]] = [
            *(self._reports(place) for place in placed(script, start_ns, ErrorFrames)),
            self._controllers_frames(),
            *(self._babble(place) for place in placed(script, start_ns, Flood)),
        ]
        ends = [Frame(place.start_ns, _BUS_OFF, bytes(8), is_error=True) for place in self._bus_off]
        ends += [Frame(place.end_ns, _RESTARTED, bytes(8), is_error=True) for place in self._bus_off]
        self._frames = heapq.merge(sorted(ends, key=_time), self._on_the_bus(senders), key=_time)
        self._next = next(self._frames, None)

    @property
    def next_t_ns(self) -> int | None:
        """When the next frame is due or the interface changes, None after the last."""
        times = list(self._interface_changes)[:1]
        if self._next is not None:
            times.append(self._next.t_ns)
        return min(times, default=None)

    def due(self, t_ns: int) -> list[Frame]:
        """The frames due by `t_ns`; the interface is then as it should be at `t_ns`."""
        while self._interface_changes and self._interface_changes[0] <= t_ns:
            self._set_interface(self._interface_changes.popleft())
        frames = []
        while self._next is not None and self._next.t_ns <= t_ns:
            frames.append(self._next)
            self._next = next(self._frames, None)
        return frames

    def close(self) -> None:
        """Leave the interface as it was found."""
        if self._network is not None:
            self._network.exists = True
            self._network.is_up = True

    def _set_interface(self, t_ns: int) -> None:
        if self._network is not None:
            self._network.exists = not any(place.holds(t_ns) for place in self._deleted)
            self._network.is_up = not any(place.holds(t_ns) for place in self._down)

    def _controllers_frames(self) -> Iterator[Frame]:
        while (t_ns := self._controller.next_t_ns) is not None:
            for frame in self._controller.due(t_ns):
                passed = self._passed(frame)
                if passed is not None:
                    yield passed

    def _passed(self, frame: Frame) -> Frame | None:
        """What becomes of one frame; the faults act one after the other, in the order of the script."""
        is_reading = frame.frame_id == self._reading_id
        is_bystander = frame.frame_id == self._bystander_id
        frame_id, data = frame.frame_id, frame.data
        for place, generator in self._faults:
            if not place.holds(frame.t_ns):
                continue
            fault = place.fault
            if isinstance(fault, CanSilence):
                if not is_bystander:
                    return None
            elif not is_reading:
                continue
            elif isinstance(fault, WrongIdentifier):
                frame_id = FrameId(fault.arbitration_id)
            elif isinstance(fault, WrongLength):
                data = data[: fault.length].ljust(fault.length, b"\0")
            elif isinstance(fault, FrozenFrame):
                data = self._frozen.setdefault(place.key, data)
            elif generator.random() < fault.share and data:
                bit = generator.randrange(8 * len(data))
                data = (int.from_bytes(data, "big") ^ 1 << bit).to_bytes(len(data), "big")
        is_fd = frame.is_fd and len(data) == len(frame.data)
        return Frame(frame.t_ns, frame_id.arbitration_id, data, is_extended=frame_id.is_extended, is_fd=is_fd)

    def _on_the_bus(self, senders: list[Iterator[Frame]]) -> Iterator[Frame]:
        """The frames of all senders; what a babbling node repeats is known only here."""
        last = bytes(8)
        for frame in heapq.merge(*senders, key=_time):
            if any(place.holds(frame.t_ns) for place in self._bus_off):
                continue
            if frame.data is _LAST_READING:
                frame = replace(frame, data=last, is_fd=len(last) > 8)
            elif frame.frame_id == self._reading_id and not frame.is_error:
                last = frame.data
            yield frame

    def _babble(self, place: Placed[Flood]) -> Iterator[Frame]:
        chosen = place.fault.arbitration_id
        frame_id = self._reading_id if chosen is None else FrameId(chosen)
        data = _LAST_READING if chosen is None else bytes(8)
        for t_ns in _paces(place, place.fault.rate_hz):
            yield Frame(t_ns, frame_id.arbitration_id, data, is_extended=frame_id.is_extended)

    def _reports(self, place: Placed[ErrorFrames]) -> Iterator[Frame]:
        error = place.fault.error
        for t_ns in _paces(place, place.fault.rate_hz):
            yield _error_frame(t_ns, *_ERRORS[error])
        if error in ("warning", "passive"):
            yield _error_frame(place.end_ns, *_ERROR_ACTIVE)


def _time(frame: Frame) -> int:
    return frame.t_ns


def _paces(place: Placed[Flood] | Placed[ErrorFrames], rate_hz: float) -> Iterator[int]:
    number = 0
    while (t_ns := place.start_ns + round(number * 1e9 / rate_hz)) < place.end_ns:
        yield t_ns
        number += 1


def _error_frame(t_ns: int, error_class: int, details: dict[int, int]) -> Frame:
    return Frame(t_ns, error_class, bytes(details.get(byte, 0) for byte in range(8)), is_error=True)
