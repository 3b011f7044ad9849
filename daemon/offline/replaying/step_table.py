"""Tables with a row for each step, as CSV."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from daemon.recording.errors import failed
from estimation.records import Estimate
from estimation.smoothing.settled_smoother import SmoothedStep

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
SMOOTHED_COLUMNS = (
    *COLUMNS,
    "smoothed_displacement_mm",
    "smoothed_sigma_mm",
    "smoothed_velocity_mm_s",
    "smoothed_velocity_sigma_mm_s",
)

Cells = Sequence[str]


@contextmanager
def step_table(path: Path, columns: Cells) -> Iterator[Callable[[Cells], object]]:
    """A table to add rows to; the file appears whole or not at all. Raises RecordingError."""
    part = path.with_name(f".{path.name}.part-{os.getpid()}")
    try:
        with part.open("w", newline="") as stream:
            rows = csv.writer(stream, lineterminator="\n")
            rows.writerow(columns)
            yield rows.writerow
        part.replace(path)
    except OSError as error:
        raise failed("write", path, error) from error
    finally:
        with suppress(OSError):
            part.unlink()


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


def smoothed_cells(step: SmoothedStep) -> Cells:
    """Its row under `SMOOTHED_COLUMNS`."""
    return (
        *cells(step.settled),
        _thousandths(step.displacement_m),
        _thousandths(step.sigma_m),
        _thousandths(step.velocity_m_s),
        _thousandths(step.velocity_sigma_m_s),
    )


def _thousandths(value: float) -> str:
    return f"{value * 1e3:.6f}"
