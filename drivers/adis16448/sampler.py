"""Reads one sample after the other and judges each: is it whole, is it new, when was it taken?"""

from __future__ import annotations

from bisect import bisect_left

from drivers.adis16448.burst import Burst, Fault, RepetitionWatch, failed
from drivers.adis16448.counters import FAULT_NAMES, LATENESS_BINS_US, Counters
from drivers.adis16448.device import Adis16448
from drivers.adis16448.quality import QualityWatch
from drivers.adis16448.registers import DIAG_NEW_DATA, INVALID_NS
from drivers.clock import Clock
from drivers.data_ready import Edge
from drivers.sample_timer import SampleTimer
from drivers.spi import SpiError
from estimation.records import TimeKind

_LATENESS_BINS_NS = tuple(1000 * us for us in LATENESS_BINS_US)
_LOOKS_FOR_NEWER = 3
_BURST_NS = 224_000  # 28 bytes at 1 MHz
_FLAGS = 0xFFFF & ~DIAG_NEW_DATA
# DIAG_STAT lies outside the checksum: only beside words that are as the part sent them it can be believed.
_BELIEVED = (Fault.NONE, Fault.REPEATED, Fault.OUT_OF_RANGE, Fault.SPI)


class Sampler:
    """Turns edges into bursts with their fault. Time stamps never go back; those of good bursts increase."""

    def __init__(
        self, clock: Clock, timer: SampleTimer, counters: Counters, quality: QualityWatch, taps_exponent: int
    ) -> None:
        self.open_faults = 0  # a bad sample costs one, a good one pays one back
        self.port_errors = 0  # transfers in a row that the port refused
        self.end_ns = 0  # of the last read
        self._clock = clock
        self._timer = timer
        self._counters = counters
        self._quality = quality
        self._taps_exponent = taps_exponent
        self._repetition = RepetitionWatch(taps_exponent)
        self._last_fault = Fault.NONE
        self._last_start_ns = 0  # of a read
        self._last_edge_ns = 0
        self._last_t_ns = self._last_good_t_ns = -(1 << 62)  # stamps handed out

    def begin(self) -> None:
        """The part was started."""
        self._repetition = RepetitionWatch(self._taps_exponent)
        self._last_fault = Fault.NONE
        self.open_faults = self.port_errors = 0

    def read(self, device: Adis16448, edge: Edge) -> Burst:
        """Read the sample of `edge`."""
        clock, counters, timer = self._clock, self._counters, self._timer
        start_ns = clock.now_ns()
        if edge.kind is TimeKind.EDGE:
            if start_ns - edge.t_ns > timer.period_ns:
                edge, start_ns = self._newest(edge, start_ns)
            kind, t_ns = TimeKind.EDGE, edge.t_ns
            late_ns = start_ns - t_ns
            counters.lateness[bisect_left(_LATENESS_BINS_NS, late_ns)] += 1
            if late_ns > counters.latest_read_s * 1e9:
                counters.latest_read_s = late_ns / 1e9
            counters.edge_reads += 1
            counters.missed += edge.missed
            # An edge before the last read, or too soon after the last edge, announces nothing new.
            is_doubtful = t_ns < self._last_start_ns or t_ns - self._last_edge_ns < timer.period_ns / 2
            self._last_edge_ns = min(t_ns, start_ns)
            if late_ns < 0:
                # A stamp from the future is no stamp; it would hold up all that follow.
                kind, t_ns = TimeKind.READ, start_ns
        else:
            counters.paced_reads += 1
            is_doubtful = not timer.knows_phase
            kind, t_ns = TimeKind.READ, start_ns
        counters.samples += 1
        if t_ns < self._last_t_ns:
            t_ns = self._last_t_ns
        self._last_start_ns, self._last_t_ns = start_ns, t_ns
        try:
            burst = device.read_burst(t_ns, kind)
            self.port_errors = 0
        except SpiError as error:
            counters.last_error = str(error)
            burst = failed(t_ns, kind)
            # A dead port answers at once and a floating line has no pace: do not spin.
            clock.sleep(timer.period_ns / 1e9)
            self.port_errors += 1
        self.end_ns = clock.now_ns()

        fault = self._judged(burst, edge, is_doubtful)
        flags = burst.words[0] & _FLAGS
        if flags and fault in _BELIEVED:
            self._quality.latch(flags, self.end_ns)
        self._last_fault = fault
        if fault is Fault.NONE:
            self._last_good_t_ns = t_ns
            if self.open_faults:
                self.open_faults -= 1
            return burst
        counters.faults[FAULT_NAMES[fault]] += 1
        # A late reader and a doubled edge are no faults of the part: a reset would only cost more.
        if fault is not Fault.TORN and (fault is not Fault.REPEATED or self._repetition.is_frozen):
            self.open_faults += 1
        return burst if fault is burst.fault else burst.with_fault(fault)

    def _newest(self, edge: Edge, now_ns: int) -> tuple[Edge, int]:
        """We are a sample late or more: the newest edge is the one whose sample is in the registers."""
        for _ in range(_LOOKS_FOR_NEWER):
            newer = self._timer.newer()
            if newer is None:
                break
            edge = Edge(newer.t_ns, newer.kind, edge.missed + newer.missed + 1)
            now_ns = self._clock.now_ns()
            if now_ns - edge.t_ns <= self._timer.period_ns:
                break
        return edge, now_ns

    def _judged(self, burst: Burst, edge: Edge, is_doubtful: bool) -> Fault:
        """The burst's own fault, or what its time and its predecessors show."""
        fault = burst.fault
        if fault is Fault.NONE:
            if self._repetition.is_repeated(burst, is_doubtful=is_doubtful) or burst.t_ns <= self._last_good_t_ns:
                return Fault.REPEATED
            if edge.kind is TimeKind.EDGE and self._is_too_late(burst, edge):
                return Fault.TORN
        elif fault is Fault.CRC:
            if edge.kind is TimeKind.EDGE:
                return Fault.TORN if is_doubtful or self._met_update(edge) else fault
            # A paced read may meet an update; half a period later it cannot meet another.
            self._timer.avoid_update()
            return fault if self._last_fault in (Fault.CRC, Fault.TORN) else Fault.TORN
        return fault

    def _is_too_late(self, burst: Burst, edge: Edge) -> bool:
        """Whether the words may be the next sample's: a whole one passes every checksum.

        With a checksum the start of the read decides: a thread that was held up afterwards did no harm.
        """
        if burst.crc is None:
            return self._met_update(edge)
        return self._last_start_ns + _BURST_NS > edge.t_ns + self._timer.period_ns - INVALID_NS

    def _met_update(self, edge: Edge) -> bool:
        """Whether the read ended after the registers began to change for the next sample."""
        return self.end_ns > edge.t_ns + self._timer.period_ns - INVALID_NS
