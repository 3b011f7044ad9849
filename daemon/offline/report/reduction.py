"""Long records made small: least and largest value in each cell of a grid, and all samples where it matters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Times = NDArray[np.int64]

CELL_NS = 100_000_000
MOST_CELLS = 40_000  # beyond 67 minutes the cells grow
AROUND_NS = 3_000_000_000  # an onset or a stop
ALL_SAMPLES = 30_000  # a short record is kept whole


@dataclass(slots=True, frozen=True)
class Grid:
    """Cells of equal length that cover a record."""

    begin_ns: int
    cell_ns: int
    cells: int

    @classmethod
    def over(cls, begin_ns: int, end_ns: int) -> Grid:
        """From the first to the last time."""
        span_ns = end_ns - begin_ns + 1
        cell_ns = max(CELL_NS, -(-span_ns // MOST_CELLS))
        return cls(begin_ns, cell_ns, max(1, -(-span_ns // cell_ns)))

    def places(self, t_ns: Times) -> NDArray[np.int64]:
        """The cell of each time; of one outside, the nearest."""
        return np.clip((t_ns - self.begin_ns) // self.cell_ns, 0, self.cells - 1)

    def aligned(self, stretches: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
        """The stretches made longer to whole cells, so that none is half inside; joined where they meet."""
        found: list[tuple[int, int]] = []
        for begin_ns, end_ns in stretches:
            first = max(0, (begin_ns - self.begin_ns) // self.cell_ns)
            last = min(self.cells, (end_ns - self.begin_ns) // self.cell_ns + 1)
            aligned = self.begin_ns + first * self.cell_ns, self.begin_ns + last * self.cell_ns - 1
            if found and aligned[0] <= found[-1][1] + 1:
                found[-1] = (found[-1][0], aligned[1])
            elif last > first:
                found.append(aligned)
        return found

    def envelope(self, t_ns: Times, low: Floats, high: Floats | None = None) -> tuple[Floats, Floats]:
        """Least of `low` and largest of `high` (default: the same values) in each cell, NaN where there are none."""
        places = self.places(t_ns)
        return _reduced(self.cells, places, low, np.fmin), _reduced(
            self.cells, places, low if high is None else high, np.fmax
        )


def _reduced(cells: int, places: NDArray[np.int64], values: Floats, choose: np.ufunc) -> Floats:
    reduced = np.full(cells, np.nan, dtype=np.float32)
    choose.at(reduced, places, values)
    return reduced


def windows(marks_ns: Iterable[int], begin_ns: int, end_ns: int, samples: int) -> list[tuple[int, int]]:
    """Stretches of time to keep whole: around the marks, joined where they meet; all of a record of few samples."""
    if samples <= ALL_SAMPLES:
        return [(begin_ns, end_ns)]
    found: list[tuple[int, int]] = []
    for mark_ns in sorted(marks_ns):
        first_ns, last_ns = mark_ns - AROUND_NS, mark_ns + AROUND_NS
        if found and first_ns <= found[-1][1]:
            found[-1] = (found[-1][0], last_ns)
        else:
            found.append((first_ns, last_ns))
    return found


def within(kept: Sequence[tuple[int, int]], t_ns: Times) -> NDArray[np.bool_]:
    """Which of the times lie in one of the stretches."""
    chosen = np.zeros(len(t_ns), dtype=np.bool_)
    for begin_ns, end_ns in kept:
        chosen |= (t_ns >= begin_ns) & (t_ns <= end_ns)
    return chosen


def runs(t_ns: Times, codes: NDArray[np.uint8]) -> list[tuple[int, int, int]]:
    """Begin, end and code of each stretch in which the code stays the same; the end is the next one's begin."""
    if len(codes) == 0:
        return []
    changes = np.flatnonzero(np.diff(codes)) + 1
    begins = [0, *changes.tolist()]
    ends = [*changes.tolist(), len(codes) - 1]
    return [(int(t_ns[a]), int(t_ns[b]), int(codes[a])) for a, b in zip(begins, ends, strict=True)]
