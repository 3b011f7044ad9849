"""The numbers of a report as one JSON object, arrays as base64 of little-endian numbers."""

from __future__ import annotations

import base64
from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.offline.report.collecting import (
    READING_WORDS,
    SEGMENTS,
    STATES,
    Collector,
    Readings,
    State,
)
from daemon.offline.report.findings import STANDS_NS, words
from daemon.offline.report.reduction import Floats, Grid, Times, runs, windows, within
from daemon.offline.report.times import Clock
from daemon.offline.reviewing.reference_errors import SIGMAS_95
from estimation.records import Move

Packed = dict[str, Any]
_TICKS = 2**32  # fine times are 32-bit counts


def pack(collected: Collector, moves: list[Move], clock: Clock, stroke_mm: float) -> Packed:
    """Everything that plots show; times are seconds from `zero_ns` on."""
    begin_ns, end_ns = collected.first_ns or 0, collected.last_ns or 0
    steps = collected.steps
    t_ns = _times(steps.t_ns)
    if len(t_ns):
        begin_ns, end_ns = min(begin_ns, int(t_ns[0])), max(end_ns, int(t_ns[-1]))
    packer = _Packer(begin_ns, end_ns, [mark for move in moves for mark in (move.onset_ns, move.stop_ns)], t_ns)
    stroke, sigma, velocity, acceleration = (
        _values(column) for column in (steps.stroke, steps.sigma, steps.velocity, steps.acceleration)
    )
    signals = {
        "stroke": packer.signal(stroke, fine=True) | packer.around(sigma),
        "smoothed": packer.signal(_values(steps.smoothed)),
        "velocity": packer.signal(velocity, fine=True) | packer.around(_values(steps.velocity_sigma)),
        "acceleration": packer.signal(acceleration, fine=True),
        "chart": packer.signal(_values(steps.chart_lower), _values(steps.chart_upper)),
        "innovation": packer.signal(_values(steps.innovation)),
        "gate": packer.largest(_values(steps.gate)),
    }
    return {
        "zero_ns": begin_ns,
        "clock": {"wall": clock.wall_minus_own_ns is not None, "name": clock.name, "zero": clock.axis_ms(begin_ns)},
        "stroke_mm": stroke_mm,
        "length": (end_ns - begin_ns) * 1e-9,
        "grid": {"begin": 0.0, "cell": packer.grid.cell_ns * 1e-9, "cells": packer.grid.cells},
        "tick": packer.tick_ns * 1e-9,
        "windows": packer.spans(packer.kept),
        "fine": packer.fine_times(t_ns),
        "signals": signals,
        "readings": {
            "observed": packer.readings(collected.observed),
            "reference": packer.readings(collected.reference),
        },
        "words": [word.replace("_", " ") for word in READING_WORDS],
        "others": {
            name: packer.signal_at(_times(course.t_ns), _values(course.stroke))
            for name, course in collected.others.items()
        },
        "segments": [
            [packer.second(begin), packer.second(end), str(SEGMENTS[code])]
            for begin, end, code in runs(t_ns, _codes(steps.segment))
        ],
        "marks": [
            {
                "onset": packer.second(move.onset_ns),
                "stop": packer.second(move.stop_ns),
                "end": packer.second(min(move.stop_ns + STANDS_NS, end_ns)),
                "kind": str(move.kind),
                "number": number,
            }
            for number, move in enumerate(moves, start=1)
        ],
        "lanes": _lanes(collected, packer, t_ns),
        "tilt": _tilt(collected, packer),
        "rates": _rates(collected, packer),
        "gaps": packer.spans(collected.gaps),
    }


class _Packer:
    """Knows where the record begins, its grid, and what is kept whole."""

    def __init__(self, begin_ns: int, end_ns: int, marks_ns: list[int], t_ns: Times) -> None:
        self.begin_ns, self.end_ns = begin_ns, end_ns
        self.grid = Grid.over(begin_ns, end_ns)
        self.kept = self.grid.aligned(windows(marks_ns, begin_ns, end_ns, len(t_ns)))
        self.tick_ns = max(1000, -(-(end_ns - begin_ns) // _TICKS))
        self._t_ns = t_ns
        self._fine = within(self.kept, t_ns)

    def second(self, t_ns: int) -> float:
        return round((t_ns - self.begin_ns) * 1e-9, 6)

    def spans(self, spans_ns: list[tuple[int, int]]) -> list[list[float]]:
        return [[self.second(begin), self.second(end)] for begin, end in spans_ns]

    def signal(self, low: Floats, high: Floats | None = None, *, fine: bool = False) -> Packed:
        packed = self.signal_at(self._t_ns, low, high)
        return packed | {"fine": self.fine(low)} if fine else packed

    def signal_at(self, t_ns: Times, low: Floats, high: Floats | None = None) -> Packed:
        lows, highs = self.grid.envelope(t_ns, low, high)
        return {"low": _base64(lows), "high": _base64(highs)}

    def around(self, sigma: Floats) -> Packed:
        """What the 95 % band reaches to either side: the largest in each cell, and all where all is kept."""
        half = np.float32(SIGMAS_95) * sigma
        return {"half": self.largest(half)["high"], "half_fine": self.fine(half)}

    def largest(self, values: Floats) -> Packed:
        """The largest in each cell."""
        return {"high": _base64(self.grid.envelope(self._t_ns, values)[1])}

    def fine(self, values: Floats) -> str:
        return _base64(values[self._fine])

    def fine_times(self, t_ns: Times) -> str:
        return self._ticks(t_ns[self._fine])

    def readings(self, readings: Readings) -> Packed | None:
        """Good ones and ill ones apart; all of them within the stretches that are kept whole."""
        if not len(readings.t_ns):
            return None
        t_ns, values, word = _times(readings.t_ns), _values(readings.value), _codes(readings.word)
        ill = word > 0
        words_of_cells = np.zeros(self.grid.cells, dtype=np.uint8)
        np.maximum.at(words_of_cells, self.grid.places(t_ns), word)
        fine = within(self.kept, t_ns)
        return {
            "good": self.signal_at(t_ns[~ill], values[~ill]),
            "ill": self.signal_at(t_ns[ill], values[ill]),
            "ill_words": _base64(words_of_cells),
            "count": len(t_ns),
            "ill_count": int(ill.sum()),
            "fine": self._ticks(t_ns[fine]),
            "fine_values": _base64(values[fine]),
            "fine_words": _base64(word[fine]),
        }

    def _ticks(self, t_ns: Times) -> str:
        return _base64(((t_ns - self.begin_ns + self.tick_ns // 2) // self.tick_ns).astype(np.uint32))


def _lanes(collected: Collector, packer: _Packer, t_ns: Times) -> list[Packed]:
    """What the estimator takes the displacement sensor for, and how each part said it is."""
    seen = [
        [packer.second(begin), packer.second(end), words(STATES[code]), ""]
        for begin, end, code in runs(t_ns, _codes(collected.steps.state))
    ]
    lanes = [{"name": "displacement, as estimated", "spans": seen}] if seen else []
    until_ns = collected.last_health_ns
    for part, states in collected.parts.items():
        if until_ns is not None and any(state.word != "off" for state in states):
            lanes.append({"name": part, "spans": _spans(states, until_ns, packer)})
    return lanes


def _spans(states: list[State], until_ns: int, packer: _Packer) -> list[list[Any]]:
    ends = [state.t_ns for state in states[1:]] + [until_ns]
    return [
        [packer.second(state.t_ns), packer.second(end), state.word, state.what]
        for state, end in zip(states, ends, strict=True)
    ]


def _tilt(collected: Collector, packer: _Packer) -> Packed:
    seconds = sorted(collected.tilt.sums)
    force = np.array([collected.tilt.sums[second] for second in seconds]).reshape(-1, 3)
    across, push, up = force.T
    pitch = np.degrees(np.arctan2(push, np.hypot(across, up)))
    roll = np.degrees(np.arctan2(-across, up))
    return {
        "t": _base64(_middles(seconds, packer)),
        "pitch": _base64(pitch.astype(np.float32)),
        "roll": _base64(roll.astype(np.float32)),
    }


def _rates(collected: Collector, packer: _Packer) -> Packed:
    """Per second, of each second that the record touches; the first and the last are not whole."""
    first, last = packer.begin_ns // 1_000_000_000, packer.end_ns // 1_000_000_000
    seconds = list(range(first, last + 1))[: 10 * 86_400]
    counters = {
        "samples": collected.samples,
        "bad": collected.bad_samples,
        "frames": collected.frames,
        "sent": collected.sent,
        "errors": collected.error_frames,
    }
    columns = {
        name: _base64(np.array([counts[second] for second in seconds], dtype=np.uint32))
        for name, counts in counters.items()
    }
    return {"t": _base64(_middles(seconds, packer))} | columns


def _middles(seconds: list[int], packer: _Packer) -> NDArray[np.float32]:
    """Seconds of the clock, each at its middle, from the record's begin on."""
    return np.array([second + 0.5 - packer.begin_ns * 1e-9 for second in seconds], dtype=np.float32)


def _times(column: array[int]) -> Times:
    return np.frombuffer(column, dtype=np.int64)


def _values(column: array[float]) -> Floats:
    return np.frombuffer(column, dtype=np.float32)


def _codes(column: array[int]) -> NDArray[np.uint8]:
    return np.frombuffer(column, dtype=np.uint8)


def _base64(values: NDArray[Any]) -> str:
    little = values.astype(values.dtype.newbyteorder("<"), copy=False)
    return base64.b64encode(little.tobytes()).decode("ascii")
