"""The CAN link: one task that reads, survives everything a bus can do, and says what happened.

Why not python-can's asyncio Notifier: when `recv` raises on a bus with a file descriptor (SocketCAN,
udp_multicast), its reader callback fires again at once and for ever, no listener's `on_error` is called and
an AsyncBufferedReader waits for ever: a spinning loop and silence (python-can 4.6; its issues 1865, 1912,
1667, 907).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterator
from dataclasses import asdict
from typing import Any

import can

from drivers.can.arrival import ArrivalTimes
from drivers.can.diagnosis import Failure, LinkFacts, diagnose, failure_of
from drivers.can.error_frames import BUS_OFF
from drivers.can.error_tally import TOLD_S, ErrorTally
from drivers.can.frame import Frame, FrameId
from drivers.can.intake import CanCounters, Intake
from drivers.can.interface import InterfaceFault, interface_status, open_bus, to_message
from drivers.can.opened import OpenedBus
from drivers.can.rate import RecentCount
from drivers.can.reader import PacedReader
from drivers.can.settings import CanSettings
from drivers.clock import Clock
from drivers.condition import Condition

FRAMES_PER_WAKE = 64  # a flood must leave the event loop time for everything else
FRAMES_PER_DRAIN = 4096
FIRST_BACKOFF_S = 0.1
LONGEST_BACKOFF_S = 5.0
SUPERVISE_S = 1.0  # how often the task shows that it lives and asks about an interface that is silent
SILENT_S = 5.0  # no source worth waiting for pauses as long, unless its time-out says so
EMPTY_WAKES = 100  # a descriptor that is readable as often without giving a frame is broken


class _BusFailure(Exception):
    """The bus must be opened anew."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.what)
        self.failure = failure


class CanBus:
    """A CAN interface that is reopened for as long as it takes.

    Args:
        settings: which interface, and whether it may send.
        on_frame: called in the event loop with every frame, error frames included. What it raises ends `run`.
        clock: source of the monotonic times of frames.
        ids: identifiers to receive, None for all.
        opener: opens the python-can bus, which must have a file descriptor.
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
        self._ids = ids
        self._opener = opener
        self._intake = Intake(ids, max(SILENT_S, settings.displacement.timeout_ms * 1e-3))
        self._open_bus: OpenedBus | None = None
        self._failure: Failure | None = Failure(f"{settings.channel} is not opened yet", "wait a moment")
        self._was_open = False
        self._backoff = backoff_s()
        self._next_try_ns = 0  # of `drain`
        self._supervised_ns = 0  # by `drain`
        self._arrivals = ArrivalTimes(clock)
        self._reads = self._reads_before = 0  # messages read, now and at the last supervision
        self._empty_wakes = 0
        self._send_error = ""
        self._never_sent = RecentCount(TOLD_S)
        self.last_error = ""  # the last failure to open, read, send or close
        self.progress = 0  # grows at least once a second while the task lives, whatever the bus does

    @property
    def counters(self) -> CanCounters:
        """What happened on the link since the start."""
        return self._intake.counters

    @property
    def errors(self) -> ErrorTally:
        """What the error frames said."""
        return self._intake.errors

    @property
    def controller_state(self) -> str:
        """error-active, error-warning, error-passive or bus-off, as last told."""
        if self._open_bus is not None and not self._open_bus.has_carrier:
            return BUS_OFF  # without an error frame: it was so when the bus was opened
        return self.errors.state

    @property
    def condition(self) -> Condition:
        """How the link is now, in words for people."""
        now_ns = self._clock.now_ns()
        return diagnose(
            LinkFacts(
                channel=self._settings.channel,
                failure=self._failure,
                controller_state=self.controller_state,
                transmit_errors=self.errors.transmit_errors,
                receive_errors=self.errors.receive_errors,
                bus_offs=self.errors.recent_bus_offs(now_ns),
                nobody_acknowledges=self._intake.nobody_acknowledges(now_ns),
                error_frames=self.errors.in_last_second(now_ns),
                last_error=self.errors.last,
                silent_s=self._intake.silent_s(now_ns),
                unwanted_only_s=self._intake.unwanted_only_s(now_ns),
                wanted=self._intake.wanted(),
                strangers=self._intake.strangers(),
                overload=self._intake.recent_overload(now_ns),
                kernel_drops=self._intake.recent_drops(now_ns),
                send_error=self._send_error,
                never_sent=self._never_sent.count(now_ns),
            )
        )

    def report(self) -> dict[str, Any]:
        """Numbers and words for the health record."""
        errors = self.errors
        return asdict(self.counters) | {
            "controller": self.controller_state,
            "transmit_errors": errors.transmit_errors,
            "receive_errors": errors.receive_errors,
            "error_kinds": dict(errors.kinds),
            "error_frames_per_s": errors.in_last_second(self._clock.now_ns()),
            "last_error_frame": errors.last,
            "last_error_frame_s": None if errors.last_ns is None else round(errors.last_ns * 1e-9, 3),
            "last_error": self.last_error,
        }

    async def run(self) -> None:
        """Receive until cancelled; failures of the bus lead to another try, never out of here."""
        try:
            while True:
                try:
                    await self._receive_until_failure(self._open())
                except _BusFailure as failure:
                    self._note_failure(failure)
                self._close()
                await self._pause(next(self._backoff))
        finally:
            self.close()

    def drain(self) -> list[Frame]:
        """All frames waiting, stamped with the clock's time; for simulated time, without an event loop.

        Opens the bus if need be and supervises it; a failure is counted and gives an empty or short list.
        """
        frames: list[Frame] = []
        now_ns = self._clock.now_ns()
        if self._open_bus is None and now_ns < self._next_try_ns:
            return frames
        try:
            opened = self._open_bus or self._open()
            for _ in range(FRAMES_PER_DRAIN):
                message = self._receive(opened)
                if message is None:
                    break
                frame = self._intake.take(message, now_ns)
                if frame is not None:
                    frames.append(frame)
            if now_ns - self._supervised_ns >= SUPERVISE_S * 1e9:
                self._supervised_ns = now_ns
                self._supervise(opened)
        except _BusFailure as failure:
            self._note_failure(failure)
            self._close()
            self._next_try_ns = now_ns + round(next(self._backoff) * 1e9)
        return frames

    def send(self, frame: Frame) -> bool:
        """Send at once or not at all; a failure is counted and stands in `last_error`."""
        try:
            if self._settings.listen_only:
                raise ValueError("the option `listen_only` forbids to send")
            if self._open_bus is None:
                raise ValueError("cannot send, the bus is not open")
            self._open_bus.bus.send(to_message(frame), timeout=0)
        except Exception as error:  # whatever a back end finds to raise
            self.counters.send_failures += 1
            self.last_error = self._send_error = self._describe(error)
            return False
        self.counters.sent += 1
        self._send_error = ""
        return True

    def close(self) -> None:
        """Close the bus; `run` and `drain` would open it again."""
        self._close()
        self._failure = Failure(f"{self._settings.channel} is closed", "start the program")

    def _open(self) -> OpenedBus:
        try:
            status = interface_status(self._settings)
            opened = OpenedBus(self._settings, self._opener(self._settings, self._ids), status)
        except Exception as error:  # whatever a back end finds to raise, the answer is another try
            raise self._failed(error) from error
        self.counters.reconnects += self._was_open
        self._was_open = True
        self._open_bus = opened
        self._failure = None
        self._empty_wakes = 0
        self._send_error = ""
        self._supervised_ns = self._clock.now_ns()
        self._intake.restart(self._supervised_ns)
        return opened

    def _close(self) -> None:
        opened, self._open_bus = self._open_bus, None
        if opened is None:
            return
        self._intake.note_drops(opened.new_drops(), self._clock.now_ns())
        try:
            opened.bus.shutdown()
        except Exception as error:
            self.last_error = self._describe(error)

    async def _pause(self, delay_s: float) -> None:
        """Wait, but show meanwhile that the task lives."""
        while delay_s > 0:
            await asyncio.sleep(min(delay_s, SUPERVISE_S))
            delay_s -= SUPERVISE_S
            self.progress += 1

    async def _receive_until_failure(self, opened: OpenedBus) -> None:
        try:
            self._arrivals.restart()
            reader = PacedReader(opened.bus.fileno(), lambda: self._read_batch(opened))
            reader.start()
        except (OSError, ValueError, NotImplementedError) as error:  # no descriptor, or none to wait for
            raise self._failed(error) from error
        try:
            while True:
                await asyncio.wait([reader.failed], timeout=SUPERVISE_S)
                if reader.failed.done():
                    reader.failed.result()
                self.counters.clock_steps += self._arrivals.check()
                self._supervise(opened)
        finally:
            reader.stop()

    def _read_batch(self, opened: OpenedBus) -> bool:
        """Hand on the frames that are waiting, at most FRAMES_PER_WAKE; whether there were as many."""
        for count in range(FRAMES_PER_WAKE):
            message = self._receive(opened)
            if message is None:
                self._empty_wakes = 0 if count else self._empty_wakes + 1
                if self._empty_wakes >= EMPTY_WAKES:
                    raise self._failed("always readable, but without a frame")
                return False
            frame = self._intake.take(message, self._arrivals.of(message.timestamp))
            if frame is not None:
                self._on_frame(frame)
        return True

    def _receive(self, opened: OpenedBus) -> can.Message | None:
        try:
            message = opened.bus.recv(0)
        except Exception as error:  # CanError, OSError, on odd control data AssertionError
            raise self._failed(error) from error
        if message is not None:
            self._reads += 1
            self._backoff = backoff_s()
        return message

    def _supervise(self, opened: OpenedBus) -> None:
        """Once a second: is a bus that gives nothing still the one that was opened?

        python-can reads ENETDOWN once per socket and then nothing for ever, and the socket of an interface
        that was deleted and made anew stays dead without a word.
        """
        self.progress += 1
        self._empty_wakes = 0
        now_ns = self._clock.now_ns()
        self._intake.note_drops(opened.new_drops(), now_ns)
        self._never_sent.add(now_ns, opened.new_never_sent())
        if self._reads != self._reads_before:
            opened.note_frames()
        else:
            try:
                if opened.check(self.counters.sent):
                    self._intake.note_filtered(now_ns)
            except InterfaceFault as fault:
                raise self._failed(fault) from fault
        self._reads_before = self._reads

    def _note_failure(self, failure: _BusFailure) -> None:
        self.counters.failures += 1
        self._failure = failure.failure
        self.last_error = failure.failure.what

    def _failed(self, reason: Exception | str) -> _BusFailure:
        if isinstance(reason, InterfaceFault):
            return _BusFailure(Failure(self._describe(reason.what), reason.advice))
        number = getattr(reason, "errno", None) or getattr(reason, "error_code", None)
        return _BusFailure(failure_of(self._describe(reason), self._settings.channel, number))

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
