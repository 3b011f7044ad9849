"""The picture of a recorded sensor's noise. matplotlib is heavy and loads only here, on use."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from daemon.extras import needs
from daemon.offline.alignment.allan import Allan, Axis
from daemon.offline.alignment.allan_report import ACCEL, GYRO, Units
from daemon.offline.pictures import save_picture
from daemon.offline.plots import BLUE, GREEN, VERMILION, PlotError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = (BLUE, GREEN, VERMILION)
LEAST_SHARE = 0.05  # of a deviation is drawn below it where one sigma reaches zero


def plot_allan(path: Path, found: Allan) -> None:
    """Allan deviations of both sensors with one sigma, fitted lines and floors. Raises PlotError."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise PlotError(needs("a plot", "matplotlib", "offline")) from error
    figure = Figure(figsize=(11, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(
        f"{found.source}, {1 / found.period_s:.0f} samples a second\n"
        "shaded: one sigma; dashed: white noise; circle: floor, triangle: floor not reached",
        fontsize=10,
    )
    panels = figure.subplots(1, 2)
    for one, axes, units in zip(panels, (found.gyro, found.accel), (GYRO, ACCEL), strict=True):
        for axis, colour in zip(axes, COLOURS, strict=True):
            _draw(one, axis, units, colour)
        if not all(axis.noise.constant for axis in axes):
            one.set_xscale("log")
            one.set_yscale("log")
        one.set_title(units.title)
        one.set_xlabel("averaging time [s]")
        one.set_ylabel(f"Allan deviation [{units.rate}]")
        one.grid(alpha=0.3, which="both", linewidth=0.4)
        one.legend(fontsize=8)
    try:
        save_picture(figure, path)
    except (OSError, ValueError) as problem:
        raise PlotError(f"cannot write {path}: {getattr(problem, 'strerror', None) or problem}") from problem


def _draw(one: Axes, axis: Axis, units: Units, colour: str) -> None:
    curve, white, floor = axis.noise.curve, axis.noise.white, axis.noise.instability
    if axis.noise.constant:
        one.plot([], [], color=colour, label=f"{axis.name}: constant")
        return
    deviation, share = curve.deviation * units.per_rate, curve.relative_sigma
    words = "no white noise" if white is None else f"{white.density * units.per_walk:.3g} {units.walk}"
    if floor is not None:
        words += f", {'' if floor.reached else 'at most '}{floor.value * units.per_rate:.2g} {units.rate}"
    one.plot(curve.tau_s, deviation, color=colour, linewidth=1.2, label=f"{axis.name}: {words}")
    one.fill_between(
        curve.tau_s,
        deviation * np.maximum(1 - share, LEAST_SHARE),
        deviation * (1 + share),
        color=colour,
        alpha=0.15,
        linewidth=0,
    )
    if white is not None:
        ends = np.array([white.from_s, white.to_s])
        line = white.density * units.per_rate / np.sqrt(ends)
        one.plot(ends, line, color=colour, linestyle="--", linewidth=1.0)
    if floor is not None:
        at = float(np.interp(floor.tau_s, curve.tau_s, deviation))
        one.plot([floor.tau_s], [at], "o" if floor.reached else "v", color=colour, fillstyle="none", markersize=7)
