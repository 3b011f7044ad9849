"""The acquisition thread: wait for data-ready, read one burst, stamp it, hand over blocks."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from drivers.adis16448.burst import Burst, Fault, RepetitionWatch
from drivers.adis16448.configuration import ImuSettings
from drivers.clock import Clock
from drivers.data_ready import DataReady, DataReadyError, Edge, PacedDataReady
from estimation.records import TimeKind

_HANDOVER_S = 0.1  # a block is handed over at this age even if it is not full
_SILENT_S = 0.25  # a line silent that long is given up for a while
_RETRY_S = 1.0  # and tried again that often
_PAUSE_AFTER_ERROR_S = 0.1
_JOIN_S = 5.0

_log = logging.getLogger(__name__)


class BurstReader(Protocol):
    """What acquisition needs of a device."""

    settings: ImuSettings

    def read_burst(self, edge: Edge) -> Burst:
        """Read the sample announced by `edge`."""


@dataclass(slots=True)
class Counters:
    """What happened since the start."""

    samples: int = 0  # bursts read, good or bad
    missed: int = 0  # samples the part made that nobody read
    paced_reads: int = 0  # bursts read without an edge
    silences: int = 0  # times the data-ready line was given up
    errors: int = 0  # exceptions that the thread survived; each cost a block at most
    last_error: str = ""
    faults: dict[Fault, int] = field(default_factory=lambda: dict.fromkeys(list(Fault)[1:], 0))


@dataclass(slots=True)
class _Line:
    """The data-ready line, with paced reads in its place while it is silent."""

    line: DataReady
    clock: Clock
    period_s: float
    counters: Counters
    pace: PacedDataReady | None = None
    silent_s: float = 0.0
    retry_ns: int = 0

    def next(self) -> Edge | None:
        """The next sample to read; None after at most the age at which a block is handed over."""
        if self.pace is not None:
            edge = self._edge_after_silence() if self.clock.now_ns() >= self.retry_ns else None
            return edge or self.pace.wait(_HANDOVER_S)
        try:
            edge = self.line.wait(_HANDOVER_S)
        except DataReadyError as error:
            self._give_up(str(error))
            return None
        if edge is not None:
            self.silent_s = 0.0
            return edge
        self.silent_s += _HANDOVER_S
        if self.silent_s >= _SILENT_S:
            self._give_up(f"the data-ready line was silent for {self.silent_s:.1f} s")
        return None

    def avoid_update(self) -> None:
        """A paced read met the part's update of its registers: step out of its way.

        The two clocks differ by up to 3 %, so the next reads would meet it too.
        """
        pace = self.line if self.pace is None else self.pace
        if isinstance(pace, PacedDataReady):
            pace.postpone(self.period_s / 2)

    def _give_up(self, why: str) -> None:
        self.counters.silences += 1
        self.counters.last_error = f"{why}: reads are paced until it is back; check its wire"
        _log.warning("%s", self.counters.last_error)
        self.silent_s = 0.0
        self.pace = PacedDataReady(self.clock, self.period_s)
        self.retry_ns = self.clock.now_ns() + round(_RETRY_S * 1e9)

    def _edge_after_silence(self) -> Edge | None:
        """An edge of a line that lives again. Queued edges are old, and their samples were read in paces."""
        try:
            self.line.wait(0.0)
            edge = self.line.wait(2 * self.period_s)
        except DataReadyError:
            edge = None
        if edge is None:
            self.retry_ns = self.clock.now_ns() + round(_RETRY_S * 1e9)
            return None
        _log.info("the data-ready line is back")
        self.pace = None
        return Edge(edge.t_ns, edge.kind)


class Acquisition:
    """Reads bursts in blocks, in a thread of its own or, in simulated time, by calls of `read_block`."""

    def __init__(
        self,
        device: BurstReader,
        data_ready: DataReady,
        clock: Clock,
        block_samples: int,
        on_block: Callable[[list[Burst]], None],
    ) -> None:
        settings = device.settings
        self.counters = Counters()
        self._device = device
        self._clock = clock
        self._block_samples = block_samples
        self._on_block = on_block
        self._period_s = settings.nominal_period_s
        self._line = _Line(data_ready, clock, self._period_s, self.counters)
        self._repetition = RepetitionWatch(self._period_s, settings.filter_taps_exponent)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="acquisition", daemon=True)

    @property
    def is_paced(self) -> bool:
        """Whether the data-ready line is given up for now."""
        return self._line.pace is not None

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(_JOIN_S)

    def read_block(self) -> list[Burst]:
        """Read up to a block of bursts; fewer, even none, if they take longer than 0.1 s to come."""
        block: list[Burst] = []
        while len(block) < self._block_samples:
            edge = self._line.next()
            if edge is None:
                break
            block.append(self._read(edge))
            if edge.t_ns - block[0].t_ns >= _HANDOVER_S * 1e9:
                break
        return block

    def _read(self, edge: Edge) -> Burst:
        counters = self.counters
        burst = self._device.read_burst(edge)
        counters.samples += 1
        counters.missed += edge.missed
        if edge.kind is TimeKind.READ:
            counters.paced_reads += 1
        if burst.fault is Fault.NONE and self._repetition.is_repeated(burst):
            burst = Burst(burst.t_ns, burst.time_kind, burst.words, burst.crc, Fault.REPEATED)
        if burst.fault is not Fault.NONE:
            counters.faults[burst.fault] += 1
            if burst.fault is Fault.CRC:
                self._line.avoid_update()
            if burst.fault is Fault.SPI:
                # A dead port answers at once and a floating line has no pace: do not spin.
                self._clock.sleep(self._period_s)
        return burst

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                block = self.read_block()
                if block:
                    self._on_block(block)
            except Exception as error:
                self.counters.errors += 1
                self.counters.last_error = f"{type(error).__name__}: {error}"
                _log.exception("the acquisition goes on after an error")
                self._clock.sleep(_PAUSE_AFTER_ERROR_S)
