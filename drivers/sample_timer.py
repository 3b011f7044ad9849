"""When to read the next sample: at each edge of the data-ready line, or at the learned pace while it is silent."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from drivers.clock import Clock
from drivers.data_ready import DataReady, DataReadyError, Edge
from estimation.records import TimeKind

# A line silent that long is paced around. Shorter than a stop of the part, so that pacing loses little; longer
# than any delay of an edge, whose time the kernel stamps anyway.
_SILENT_S = 0.05
_SILENT_PERIODS = 4
_REOPEN_S = 1.0
# A paced read starts that long after the expected update: in the first half of the millisecond in which the
# registers rest, so that neither an early nor a late clock meets their change at once.
_AFTER_UPDATE_S = 0.0003
_LONGEST_MEAN = 1024  # edges: the period is learned to better than 0.1 us, and follows the temperature
# A line that brings less than half its edges is no use; judged over that long, and not over a few periods.
_RATE_S = 0.125
_RATE_PERIODS = 16
_LEAST_RATE = 0.5
_STEPS_TO_TRUST = 3  # distances in a row that are a period: four edges that no disturbance imitates
_MOST_HEARD = 8  # edges listened to before one paced read; a line that has more floats
# How far off the period may be before and after that many edges: what is less is no lost edge.
_EDGES_TO_LEARN = 64
_UNLEARNED, _LEARNED = 0.03, 0.001
_TOLERANCE = 0.1  # the part's clock is within 3 % of nominal, a stamp 50 us late; beyond it is no period
_MOST_STALE = 64  # edges looked at to clear a queue; a line that has more floats


class SampleTimer:
    """Finds the next sample to read; raises nothing.

    Args:
        clock: of the run.
        nominal_period_s: between two samples, by the data sheet.
        open_line: opens the data-ready line (DataReadyError if it cannot); None: there is no line.
    """

    def __init__(self, clock: Clock, nominal_period_s: float, open_line: Callable[[], DataReady] | None) -> None:
        self.is_paced = open_line is None
        self.silences = 0  # times the line was given up
        self.line_failures = 0  # times it could not be opened or read
        self.missed_paced = 0  # periods without a read while reads were paced
        self.missed_silent = 0  # periods that passed before a silent line was given up
        self.missed_unseen = 0  # edges that should have come between two that did
        self.unheeded = 0  # edges that came while reads were paced and did not end that
        self.is_sparse = False  # the line was given up because it brings too few edges
        self.line_error = ""
        self._clock = clock
        self._open_line = open_line
        self._line: DataReady | None = None
        self._reopen_ns = clock.now_ns()
        self._nominal_ns = nominal_period_s * 1e9
        self._silent_ns = round(max(_SILENT_S * 1e9, _SILENT_PERIODS * self._nominal_ns))
        self._shortest_ns = (1 - _TOLERANCE) * self._nominal_ns
        self._longest_ns = (1 + _TOLERANCE) * self._nominal_ns
        self._rate_ns = round(max(_RATE_S * 1e9, _RATE_PERIODS * self._nominal_ns))
        self._rate_start_ns = clock.now_ns()
        self._rate_edges = 0
        self._steps = 0  # distances in a row that are a period
        self._last_edge_ns: int | None = None
        self._is_sampling = False
        self._alive_ns = clock.now_ns()  # last edge, or the start
        self._due_ns = clock.now_ns()
        self.forget()

    @property
    def has_line(self) -> bool:
        """Whether there should be a data-ready line."""
        return self._open_line is not None

    @property
    def knows_phase(self) -> bool:
        """Whether paced reads follow edges that were seen, not a guess."""
        return self._edges > 0

    def forget(self) -> None:
        """Another part: its clock is unknown."""
        self._edges = 0
        self.period_ns = self._nominal_ns

    def skip(self) -> int:
        """Forget the edges up to now, while the part is being started; returns how many there were."""
        skipped = 0
        self._is_sampling = False
        if self._line_is_open():
            for _ in range(_MOST_STALE):
                edge = self._wait(0.0)
                if edge is None:
                    break
                skipped += edge.missed + 1
        self._forget_edge()
        return skipped

    def begin(self) -> None:
        """The part starts to sample now."""
        self._is_sampling = True
        self._alive_ns = self._rate_start_ns = self._clock.now_ns()
        self._rate_edges = 0
        if self.is_paced:
            self._due_ns = self._first_due()

    def next(self, until_ns: int) -> Edge | None:
        """The next sample to read; None if there is none by `until_ns`."""
        if not self.is_paced:
            silent_ns = self._alive_ns + self._silent_ns
            edge = self._wait(max(0, min(until_ns, silent_ns) - self._clock.now_ns()) / 1e9)
            if edge is not None:
                return edge
            if not self.is_paced and self._clock.now_ns() < silent_ns:
                return None
            self._give_up()
        return self._paced(until_ns)

    def newer(self) -> Edge | None:
        """The newest edge if one came since the last."""
        return None if self._line is None else self._wait(0.0)

    def avoid_update(self) -> None:
        """A paced read met the part's update of its registers: step out of its way."""
        if self.is_paced:
            self._due_ns += round(self.period_ns / 2)

    def close(self) -> None:
        """Give the line back."""
        line, self._line = self._line, None
        if line is not None:
            with contextlib.suppress(OSError):  # a line that failed may refuse even that
                line.close()

    def _paced(self, until_ns: int) -> Edge | None:
        end_ns = min(self._due_ns, until_ns)
        if self._line_is_open():
            edge = self._trusted(end_ns)
            if edge is not None:
                return edge
        ahead_ns = end_ns - self._clock.now_ns()
        if ahead_ns > 0:
            self._clock.sleep(ahead_ns / 1e9)
        now_ns = self._clock.now_ns()
        if now_ns < self._due_ns:
            return None
        missed = int((now_ns - self._due_ns) // self.period_ns)
        self.missed_paced += missed
        self._due_ns += round((missed + 1) * self.period_ns)
        return Edge(now_ns, TimeKind.READ, 0)

    def _trusted(self, end_ns: int) -> Edge | None:
        """Listen while reads are paced: the edge that ends this, being one of several in step."""
        for _ in range(_MOST_HEARD):
            if self._line is None:
                return None
            edge = self._wait(max(0, end_ns - self._clock.now_ns()) / 1e9)
            if edge is None:
                return None
            if self._steps >= _STEPS_TO_TRUST:
                self.is_paced = self.is_sparse = False
                self._rate_start_ns, self._rate_edges = self._alive_ns, 0
                return edge
            self.unheeded += edge.missed + 1
        return None

    def _wait(self, timeout_s: float) -> Edge | None:
        """The line's next edge, from which the period is learned; a line that fails is closed."""
        assert self._line is not None
        try:
            edge = self._line.wait(timeout_s)
        except DataReadyError as error:
            self._fail(error)
            return None
        if edge is None:
            return None
        # A stamp from the future, or from before the last, would spoil the distances to come.
        t_ns = min(edge.t_ns, self._clock.now_ns())
        if self._last_edge_ns is not None:
            t_ns = max(t_ns, self._last_edge_ns)
            self._measure(t_ns - self._last_edge_ns, edge.missed + 1)
        self._last_edge_ns = self._alive_ns = t_ns
        self._rate_edges += edge.missed + 1
        if self._is_sampling and not self.is_paced and t_ns - self._rate_start_ns >= self._rate_ns:
            if self._rate_edges * self.period_ns < _LEAST_RATE * (t_ns - self._rate_start_ns):
                self._give_up()
                self.is_sparse = True
            self._rate_start_ns, self._rate_edges = t_ns, 0
        return edge

    def _measure(self, distance_ns: int, edges: int) -> None:
        """What the time in which that many edges came tells of the period, and of edges that did not come."""
        step_ns = distance_ns / edges
        if self._is_sampling and not self.is_paced:
            error = _LEARNED if self._edges >= _EDGES_TO_LEARN else _UNLEARNED
            self.missed_unseen += max(0, round(distance_ns / (self.period_ns * (1 + error))) - edges)
        self._steps = self._steps + 1 if abs(step_ns - self.period_ns) < _TOLERANCE * self.period_ns else 0
        if self._shortest_ns < step_ns < self._longest_ns:
            self._edges = min(self._edges + 1, _LONGEST_MEAN)
            self.period_ns += (step_ns - self.period_ns) / self._edges

    def _forget_edge(self) -> None:
        self._last_edge_ns = None
        self._steps = 0

    def _line_is_open(self) -> bool:
        """Whether there is a line, opened again if it is time to try."""
        if self._line is None and self._open_line is not None and self._clock.now_ns() >= self._reopen_ns:
            try:
                self._line = self._open_line()
                self.line_error = ""
            except DataReadyError as error:
                self._fail(error)
        return self._line is not None

    def _fail(self, error: DataReadyError) -> None:
        self.line_failures += 1
        self.line_error = str(error)
        self._reopen_ns = self._clock.now_ns() + round(_REOPEN_S * 1e9)
        self.close()
        self._give_up()

    def _give_up(self) -> None:
        if not self.is_paced:
            self.is_paced = True
            self.silences += 1
            self._due_ns = self._first_due()
            if self._is_sampling:
                self.missed_silent += int((self._due_ns - self._alive_ns) // self.period_ns) - 1
            self._forget_edge()

    def _first_due(self) -> int:
        """In step with the last edge: the next read after an update to come."""
        offset_ns = self._alive_ns + _AFTER_UPDATE_S * 1e9
        periods = max(0, int((self._clock.now_ns() - offset_ns) // self.period_ns)) + 1
        return round(offset_ns + periods * self.period_ns)
