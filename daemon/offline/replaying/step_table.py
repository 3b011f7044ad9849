"""Tables with a row for each step, as CSV."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from daemon.offline.whole_file import whole_file
from estimation.records import Estimate

COLUMNS = (
    "t_s",
    "displacement_mm",
    "sigma_mm",
    "velocity_mm_s",
    "velocity_sigma_mm_s",
    "segment",
    "tier",
    "can_state",
)
Cells = Sequence[str]


@contextmanager
def step_table(path: Path, columns: Cells) -> Iterator[Callable[[Cells], object]]:
    """A table to add rows to; the file appears whole or not at all. Raises RecordingError."""
    with whole_file(path) as part, part.open("w", newline="") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow(columns)
        yield rows.writerow


def cells(estimate: Estimate) -> Cells:
    """Its row under `COLUMNS`."""
    return (
        f"{estimate.t_ns // 1_000_000_000}.{estimate.t_ns % 1_000_000_000:09d}",
        _thousandths(estimate.displacement_m),
        _thousandths(estimate.sigma_m),
        _thousandths(estimate.velocity_m_s),
        _thousandths(estimate.velocity_sigma_m_s),
        estimate.segment,
        estimate.tier,
        estimate.can_state,
    )


def _thousandths(value: float) -> str:
    return f"{value * 1e3:.6f}"
