"""Pictures for papers: the whole recording and each move, as PNG and PDF. matplotlib loads only here, on use."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daemon.extras import needs
from daemon.offline.plots import BLUE, GREEN, GREY, ORANGE, VERMILION, PlotError
from daemon.offline.report.collecting import SEGMENTS, Collector
from daemon.offline.report.findings import STANDS_NS
from daemon.offline.report.reduction import Grid, runs
from daemon.offline.reviewing.reference_errors import SIGMAS_95
from daemon.offline.whole_file import whole_file
from estimation.records import Move, Segment

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DOTS_PER_INCH = 200
AIR_NS = 2_000_000_000  # around a move
_MOST_POINTS = 4000  # a line; beyond, least and largest of each cell
_COLOURS = {Segment.VVS: ORANGE, Segment.CVS: GREEN}


@dataclass(slots=True, frozen=True)
class _Stretch:
    """What of the recording a picture shows."""

    name: str
    title: str
    begin_ns: int
    end_ns: int


def draw_pictures(folder: Path, name: str, collected: Collector, moves: Sequence[Move], stroke_mm: float) -> list[Path]:
    """The overview and each move. Raises PlotError or RecordingError; all pictures appear, or none."""
    collected.finish()
    begin_ns, end_ns = collected.first_ns or 0, collected.last_ns or 0
    stretches = [_Stretch("overview", name, begin_ns, end_ns)]
    stretches += [
        _Stretch(
            f"move-{number:03d}-{move.kind}",
            f"{name}: {move.kind} {number}",
            max(begin_ns, move.onset_ns - AIR_NS),
            min(end_ns, move.stop_ns + STANDS_NS + AIR_NS),
        )
        for number, move in enumerate(moves, start=1)
    ]
    written = []
    with ExitStack() as stack:
        for stretch in stretches:
            for ending in ("png", "pdf"):
                written.append(folder / f"{stretch.name}.{ending}")
                part = stack.enter_context(whole_file(written[-1]))
                _draw(_Shown(stretch, collected, begin_ns, stroke_mm), part, ending)
    return written


def _draw(shown: _Shown, path: Path, ending: str) -> None:
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError as error:
        raise PlotError(needs("--png", "matplotlib", "offline")) from error
    figure, axes = pyplot.subplots(
        3, 1, sharex=True, figsize=(7.2, 6.4), height_ratios=(3, 1.6, 1.6), layout="constrained"
    )
    try:
        _fill(figure, axes, shown)
        # Without dates the same recording makes the same files.
        metadata: dict[str, Any] = {"CreationDate": None} if ending == "pdf" else {"Software": None}
        figure.savefig(path, format=ending, dpi=DOTS_PER_INCH, metadata=metadata)
    finally:
        pyplot.close(figure)


class _Shown:
    """The columns of a stretch."""

    def __init__(self, stretch: _Stretch, collected: Collector, zero_ns: int, stroke_mm: float) -> None:
        self.stretch = stretch
        self._edges = -0.2 * stroke_mm, 1.2 * stroke_mm
        self._zero_ns = zero_ns
        self._steps, self.observed, self.reference = collected.steps, collected.observed, collected.reference
        t_ns = np.frombuffer(self._steps.t_ns, dtype=np.int64)
        self._part = slice(*np.searchsorted(t_ns, (stretch.begin_ns, stretch.end_ns + 1)))
        self.t_ns = t_ns[self._part]

    def seconds(self, t_ns: Any) -> Any:
        return (t_ns - self._zero_ns) * 1e-9

    def column(self, name: str, kind: Any = np.float32) -> Any:
        return np.frombuffer(getattr(self._steps, name), dtype=kind)[self._part]

    def line(self, values: Any) -> tuple[Any, Any]:
        """A line that is not heavier than can be seen."""
        if len(values) <= _MOST_POINTS:
            return self.seconds(self.t_ns), values
        span_ns = int(self.t_ns[-1] - self.t_ns[0]) + 1
        cells = _MOST_POINTS // 2
        grid = Grid(int(self.t_ns[0]), -(-span_ns // cells), cells)
        low, high = grid.envelope(self.t_ns, values)
        at = self.seconds(grid.begin_ns + (np.arange(cells) + 0.5) * grid.cell_ns)
        return np.repeat(at, 2), np.column_stack((low, high)).ravel()

    def points(self, readings: Any, *, good: bool = True) -> tuple[Any, Any]:
        """Readings, thinned out where there are too many to tell apart; nonsense far off lies at the edge."""
        t_ns = np.frombuffer(readings.t_ns, dtype=np.int64)
        word = np.frombuffer(readings.word, dtype=np.uint8)
        inside = (t_ns >= self.stretch.begin_ns) & (t_ns <= self.stretch.end_ns) & ((word == 0) == good)
        places = np.flatnonzero(inside)
        places = places[:: max(1, len(places) // _MOST_POINTS)]
        values = np.frombuffer(readings.value, dtype=np.float32)[places]
        return self.seconds(t_ns[places]), np.clip(values, *self._edges)


def _fill(figure: Figure, axes: Sequence[Axes], shown: _Shown) -> None:
    stroke, speed, burst = axes
    p, half = shown.column("stroke"), np.float32(SIGMAS_95) * shown.column("sigma")
    v, v_half = shown.column("velocity"), np.float32(SIGMAS_95) * shown.column("velocity_sigma")
    for readings, label, colour, symbol in (
        (shown.observed, "displacement sensor", GREY, "."),
        (shown.reference, "reference sensor", "black", ","),
    ):
        t_s, values = shown.points(readings)
        if len(values):
            stroke.plot(t_s, values, symbol, color=colour, markersize=2, label=label)
    t_s, values = shown.points(shown.observed, good=False)
    if len(values):
        stroke.plot(t_s, values, "x", color=VERMILION, markersize=3, label="its ill readings")
    for panel, middle, width in ((stroke, p, half), (speed, v, v_half)):
        low, high = shown.line(middle - width), shown.line(middle + width)
        panel.fill_between(low[0], low[1], high[1], color=BLUE, alpha=0.18, linewidth=0, label="stated 95 %")
        panel.plot(*shown.line(middle), color=BLUE, linewidth=1.2, label="ramstroke")
    burst.plot(*shown.line(shown.column("acceleration")), color=BLUE, linewidth=0.5, label="levelled, along the push")
    for limit, name in (("chart_lower", None), ("chart_upper", "chart limits")):
        burst.plot(*shown.line(shown.column(limit)), color=VERMILION, linewidth=0.9, label=name)
    stroke.set_ylabel("stroke [mm]")
    speed.set_ylabel("speed [mm/s]")
    burst.set_ylabel("acceleration [m/s²]")
    burst.set_xlabel("time since the recording began [s]    (orange: VVS, green: CVS)")
    figure.suptitle(shown.stretch.title)
    segments = runs(shown.t_ns, shown.column("segment", np.uint8))
    for panel in axes:
        for begin, end, code in segments:
            shade = _COLOURS.get(SEGMENTS[code])
            if shade is not None:
                panel.axvspan(*shown.seconds(np.array([begin, end])), color=shade, alpha=0.18, linewidth=0)
        panel.margins(x=0)
        panel.grid(alpha=0.3)
        panel.legend(loc="best", fontsize=7)
