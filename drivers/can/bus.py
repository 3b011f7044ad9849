"""The CAN link: one task that reads, survives everything a bus can do, and says what happened.

Why not python-can's asyncio Notifier: when `recv` raises on a bus with a file descriptor (SocketCAN,
udp_multicast), its reader callback fires again at once and for ever, no listener's `on_error` is called and
an AsyncBufferedReader waits for ever: a spinning loop and silence (python-can 4.6; its issues 1865, 1912,
1667, 907).
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass

import can

from drivers.can.error_frames import BUS_OFF, ERROR_ACTIVE, controller_state
from drivers.can.frame import Frame, FrameId
from drivers.can.interface import file_descriptor, open_bus, to_frame, to_message
from drivers.can.settings import CanSettings
from drivers.clock import Clock

FRAMES_PER_WAKE = 64  # a flood must leave the event loop time for everything else
FRAMES_PER_DRAIN = 4096
FIRST_BACKOFF_S = 0.1
LONGEST_BACKOFF_S = 5.0
POLL_S = 0.005  # for a bus without file descriptor
OLDEST_STAMP_S = 0.05  # an older kernel stamp rather means that the wall clock was set
EMPTY_WAKES = 100  # a descriptor that is always readable but never gives a frame is broken

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class CanCounters:
    """What happened on the link since the start."""

    received: int = 0  # data frames handed on
    ignored: int = 0  # data frames with identifiers that nobody asked for
    error_frames: int = 0
    sent: int = 0
    send_failures: int = 0  # refused ones included
    failures: int = 0  # failed openings and readings
    reconnects: int = 0  # openings that worked, except the first


class _BusFailure(Exception):
    """The bus must be opened anew; the text says why."""


class CanBus:
    """A CAN interface that is reopened for as long as it takes.

    Args:
        settings: which interface, and whether it may send.
        on_frame: called in the event loop with every frame, error frames included. What it raises ends `run`.
        clock: source of the monotonic times of frames.
        ids: identifiers to receive, None for all.
        opener: opens the python-can bus.
    """

    def __init__(
        self,
        settings: CanSettings,
        on_frame: Callable[[Frame], None],
        clock: Clock,
        ids: Collection[FrameId] | None = None,
        opener: Callable[[CanSettings, Collection[FrameId] | None], can.BusABC] = open_bus,
    ) -> None:
        self._settings = settings
        self._on_frame = on_frame
        self._clock = clock
        self._ids = None if ids is None else frozenset(ids)
        self._opener = opener
        self._bus: can.BusABC | None = None
        self._was_open = False
        self._waiting_for = "not opened yet"
        self._backoff = backoff_s()
        self._empty_wakes = 0
        self._last_t_ns = 0
        self.counters = CanCounters()
        self.controller_state = ERROR_ACTIVE
        self.last_error = ""

    @property
    def state(self) -> str:
        """The word "running", or "waiting: " with the reason."""
        if self._waiting_for:
            return f"waiting: {self._waiting_for}"
        if self.controller_state == BUS_OFF:
            return f"waiting: {self._settings.channel} is bus-off (restart-ms of the interface ends it)"
        return "running"

    async def run(self) -> None:
        """Receive until cancelled; failures of the bus lead to another try, never out of here."""
        try:
            while True:
                try:
                    self._open()
                    await self._receive_until_failure()
                except _BusFailure as failure:
                    self._note_failure(failure)
                self._close()
                await asyncio.sleep(next(self._backoff))
        finally:
            self.close()

    def drain(self) -> list[Frame]:
        """All frames waiting, stamped with the clock's time; for simulated time, without an event loop.

        Opens the bus if need be; a failure is counted and gives an empty or short list.
        """
        frames: list[Frame] = []
        try:
            if self._bus is None:
                self._open()
            while len(frames) < FRAMES_PER_DRAIN and (message := self._receive()) is not None:
                frame = to_frame(message, self._clock.now_ns())
                if self._admit(frame):
                    frames.append(frame)
        except _BusFailure as failure:
            self._note_failure(failure)
            self._close()
        return frames

    def send(self, frame: Frame) -> bool:
        """Send at once or not at all; a failure is counted and stands in `last_error`."""
        try:
            if self._settings.listen_only:
                raise ValueError("the option `listen_only` forbids to send")
            if self._bus is None:
                raise ValueError(f"cannot send, {self.state}")
            self._bus.send(to_message(frame), timeout=0)
        except (can.CanError, OSError, ValueError) as error:
            self.counters.send_failures += 1
            self.last_error = self._describe(error)
            return False
        self.counters.sent += 1
        return True

    def close(self) -> None:
        """Close the bus; `run` and `drain` would open it again."""
        self._close()
        self._waiting_for = "closed"

    def _open(self) -> None:
        try:
            self._bus = self._opener(self._settings, self._ids)
        except Exception as error:  # whatever a back end finds to raise, the answer is another try
            raise _BusFailure(self._describe(error)) from error
        self.counters.reconnects += self._was_open
        self._was_open = True
        if self._waiting_for:
            _log.info("CAN %s is open", self._settings.channel)
        self._waiting_for = ""
        self.controller_state = ERROR_ACTIVE
        self._empty_wakes = 0

    def _close(self) -> None:
        bus, self._bus = self._bus, None
        if bus is None:
            return
        try:
            bus.shutdown()
        except (can.CanError, OSError) as error:
            self.last_error = self._describe(error)

    def _note_failure(self, failure: _BusFailure) -> None:
        self.counters.failures += 1
        self.last_error = str(failure)
        if self._waiting_for != self.last_error:
            _log.warning("CAN is waiting: %s", failure)
        self._waiting_for = self.last_error

    async def _receive_until_failure(self) -> None:
        assert self._bus is not None
        descriptor = file_descriptor(self._bus)
        if descriptor is None:
            while True:
                self._read_batch()
                await asyncio.sleep(POLL_S)
        loop = asyncio.get_running_loop()
        failed: asyncio.Future[None] = loop.create_future()

        def on_readable() -> None:
            try:
                self._note_wake(self._read_batch())
            except Exception as error:
                loop.remove_reader(descriptor)  # else it would fire again at once
                if not failed.done():
                    failed.set_exception(error)

        loop.add_reader(descriptor, on_readable)
        try:
            await failed
        finally:
            loop.remove_reader(descriptor)

    def _read_batch(self) -> int:
        """Hand on the frames that are waiting, at most FRAMES_PER_WAKE; returns how many were read."""
        for count in range(FRAMES_PER_WAKE):
            message = self._receive()
            if message is None:
                return count
            frame = to_frame(message, self._arrival_ns(message))
            if self._admit(frame):
                self._on_frame(frame)
        return FRAMES_PER_WAKE

    def _note_wake(self, frames: int) -> None:
        self._empty_wakes = 0 if frames else self._empty_wakes + 1
        if self._empty_wakes >= EMPTY_WAKES:
            raise _BusFailure(self._describe("always readable, but without a frame"))

    def _receive(self) -> can.Message | None:
        assert self._bus is not None
        try:
            message = self._bus.recv(0)
        except Exception as error:  # CanError, OSError, on odd control data AssertionError
            raise _BusFailure(self._describe(error)) from error
        if message is not None:
            self._backoff = backoff_s()
        return message

    def _admit(self, frame: Frame) -> bool:
        """Count a frame; False if nobody asked for it."""
        if frame.is_error:
            self.counters.error_frames += 1
            self.controller_state = controller_state(frame, self.controller_state)
            return True
        if self.controller_state == BUS_OFF:
            self.controller_state = ERROR_ACTIVE  # nothing arrives while bus-off
        if self._ids is not None and frame.frame_id not in self._ids:
            self.counters.ignored += 1
            return False
        self.counters.received += 1
        return True

    def _arrival_ns(self, message: can.Message) -> int:
        """Monotonic arrival time: the kernel's stamp (wall clock) if it is plausible, else now."""
        now_ns = self._clock.now_ns()
        age_s = time.time() - message.timestamp
        t_ns = now_ns - round(age_s * 1e9) if 0 <= age_s <= OLDEST_STAMP_S else now_ns
        self._last_t_ns = max(self._last_t_ns, t_ns)
        return self._last_t_ns

    def _describe(self, reason: Exception | str) -> str:
        """The reason in words, with the interface it belongs to."""
        text = getattr(reason, "strerror", None) or str(reason) or type(reason).__name__
        return f"{self._settings.interface} {self._settings.channel}: {text}"


def backoff_s() -> Iterator[float]:
    """Seconds to wait before each try: doubling, up to LONGEST_BACKOFF_S, without end."""
    delay_s = FIRST_BACKOFF_S
    while True:
        yield delay_s
        delay_s = min(2 * delay_s, LONGEST_BACKOFF_S)
