"""What the tables of a recording hold: names with units, kinds, rows."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from daemon.inertial import SampleDecoder
from daemon.offline.reviewing.onlooker import Onlooker
from daemon.offline.reviewing.review import Review
from daemon.recording.topics import Health, LogLine, Recorded, RecordedDisplacement
from daemon.rows import move_row
from daemon.settings import Settings
from drivers.adis16448.burst import Burst
from drivers.jy901.reading import Reading
from estimation.records import Event, ImuSample, Move
from estimation.smoothing.settled_smoother import SmoothedStep

Kind = Literal["time", "thousandth", "real", "whole", "text"]
Cell = float | int | str | None


@dataclass(slots=True, frozen=True)
class Table:
    """One table: a name, and columns in order, each with its kind.

    time: nanoseconds in a column of seconds. thousandth: metres in a column of millimetres.
    """

    name: str
    columns: Mapping[str, Kind]


_SETTLED: dict[str, Kind] = {
    "t_s": "time",
    "displacement_mm": "thousandth",
    "sigma_mm": "thousandth",
    "velocity_mm_s": "thousandth",
    "velocity_sigma_mm_s": "thousandth",
    "segment": "text",
    "tier": "text",
    "can_state": "text",
}
_SMOOTHED: dict[str, Kind] = {
    "smoothed_displacement_mm": "thousandth",
    "smoothed_sigma_mm": "thousandth",
    "smoothed_velocity_mm_s": "thousandth",
    "smoothed_velocity_sigma_mm_s": "thousandth",
}
_MOVE: dict[str, Kind] = {
    "number": "whole",
    "kind": "text",
    "onset_s": "real",
    "stop_s": "real",
    "start_mm": "real",
    "end_mm": "real",
    "sigma_mm": "real",
    "end_before_stop_mm": "real",
    "sigma_before_stop_mm": "real",
    "velocity_mm_s": "real",
    "can_state": "text",
    "tier": "text",
    "smoothed_start_mm": "real",
    "smoothed_start_sigma_mm": "real",
    "smoothed_end_mm": "real",
    "smoothed_end_sigma_mm": "real",
}
STEPS_SETTLED = Table("steps", _SETTLED)
STEPS = Table("steps", _SETTLED | _SMOOTHED)
MOVES = Table("moves", _MOVE)
DISPLACEMENT = Table("displacement", {"t_s": "time", "sensor": "text", "value_mm": "thousandth", "fault": "text"})
EVENTS = Table("events", {"t_s": "time", "what": "text"})
LOG = Table("log", {"t_s": "time", "level": "whole", "logger": "text", "text": "text"})
HEALTH = Table("health", {"t_s": "time", "name": "text", "number": "real", "text": "text"})
# The names that `ramstroke import` reads.
SAMPLES = Table(
    "samples",
    {
        "t_s": "time",
        "gyro_x_rad_s": "real",
        "gyro_y_rad_s": "real",
        "gyro_z_rad_s": "real",
        "accel_x_m_s2": "real",
        "accel_y_m_s2": "real",
        "accel_z_m_s2": "real",
        "temperature_c": "real",
    },
)


class Writer(Protocol):
    """Takes rows of the tables that it was opened for."""

    def add(self, table: Table, *row: Cell) -> None:
        """Append a row."""


class TableExport(Onlooker):
    """Writes the rows as the review comes upon them."""

    def __init__(self, writer: Writer, settings: Settings, *, smoothed: bool) -> None:
        self._writer = writer
        self._decoder = SampleDecoder(settings)
        self._smoothed = smoothed

    @property
    def tables(self) -> tuple[Table, ...]:
        """All that it writes."""
        return tables(smoothed=self._smoothed)

    def replayed(self, _topic: str, record: Recorded) -> None:
        """Samples, readings, events."""
        if isinstance(record, Burst | Reading | ImuSample):
            sample = self._decoder.sample(record) if self._decoder.is_mine(record) else None
            if sample is not None:
                self._writer.add(SAMPLES, sample.t_ns, *sample.gyro, *sample.accel, sample.temperature_c)
        elif isinstance(record, RecordedDisplacement):
            reading = record.reading
            sensor = "reference" if reading.is_reference else "observed"
            self._writer.add(DISPLACEMENT, reading.t_ns, sensor, reading.value_m, reading.fault.name.lower())
        elif isinstance(record, Event):
            self._writer.add(EVENTS, record.t_ns, record.what)

    def step(self, step: SmoothedStep) -> None:
        """A settled step."""
        settled = step.settled
        row: tuple[Cell, ...] = (
            settled.t_ns,
            settled.displacement_m,
            settled.sigma_m,
            settled.velocity_m_s,
            settled.velocity_sigma_m_s,
            str(settled.segment),
            str(settled.tier),
            str(settled.can_state),
        )
        if not self._smoothed:
            self._writer.add(STEPS_SETTLED, *row)
            return
        smoothed = (step.displacement_m, step.sigma_m, step.velocity_m_s, step.velocity_sigma_m_s)
        self._writer.add(STEPS, *row, *smoothed)

    def recorded(self, _topic: str, record: Recorded) -> None:
        """Log and health."""
        if isinstance(record, LogLine):
            self._writer.add(LOG, record.t_ns, record.level, record.logger, record.text)
        elif isinstance(record, Health):
            for name, value in _flat(_parsed(record.json)):
                is_number = isinstance(value, int | float)
                self._writer.add(
                    HEALTH, record.t_ns, name, float(value) if is_number else None, None if is_number else str(value)
                )

    def finish(self, reviewed: Review) -> None:
        """Moves are known at the end: one may be opened anew after a false stop."""
        for move in reviewed.replayed.moves:
            self._writer.add(MOVES, *_move_cells(move, reviewed))


def tables(*, smoothed: bool) -> tuple[Table, ...]:
    """All tables of a recording."""
    return (STEPS if smoothed else STEPS_SETTLED, MOVES, DISPLACEMENT, EVENTS, LOG, HEALTH, SAMPLES)


def _move_cells(move: Move, reviewed: Review) -> list[Cell]:
    smoothed = reviewed.smoothed_moves.of(move)
    row: dict[str, Cell] = {"number": move.number, **move_row(move)}
    if smoothed is not None:
        for name, step in (("start", smoothed.first), ("end", smoothed.last)):
            row[f"smoothed_{name}_mm"] = step.displacement_m * 1e3
            row[f"smoothed_{name}_sigma_mm"] = step.sigma_m * 1e3
    return [row.get(name) for name in _MOVE]


def _parsed(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return {}


def _flat(tree: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every value under its whole name, such as `imu.crc_errors`; empty ones are left out."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        name = f"{path}.{key}" if path else str(key)
        if isinstance(value, dict | list):
            yield from _flat(value, name)
        elif value is not None and value != "":
            yield name, value
