"""Pictures of results. matplotlib is heavy and loads only here, on use."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from daemon.errors import CommandError
from daemon.extras import needs
from daemon.offline.pictures import save_picture
from drivers.virtual.motion import Trajectory
from estimation.records import Displacement, Estimate, Segment

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe-Ito: told apart by colour-blind readers too.
BLUE, ORANGE, GREEN, GREY, VERMILION = "#0072B2", "#E69F00", "#009E73", "#7F7F7F", "#D55E00"
SEGMENT_COLOURS = {Segment.VVS: ORANGE, Segment.CVS: GREEN}


class PlotError(CommandError):
    """A picture cannot be made; one sentence."""


def plot_demo(path: Path, truth: Trajectory, settled: Sequence[Estimate], observed: Sequence[Displacement]) -> None:
    """Stroke, error and acceleration of the demo's cycle as a PNG. Raises PlotError."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        import numpy as np
        from matplotlib import pyplot
    except ImportError as error:
        raise PlotError(needs("a plot", "matplotlib", "offline")) from error

    t_s = np.array([e.t_ns for e in settled]) * 1e-9
    p_mm = np.array([e.displacement_m for e in settled]) * 1e3
    sigma_mm = np.array([e.sigma_m for e in settled]) * 1e3
    true_mm = np.interp(t_s, truth.t_s, truth.displacement_m) * 1e3
    seen_s = np.array([r.t_ns for r in observed if r.valid]) * 1e-9
    seen_mm = np.array([r.value_m for r in observed if r.valid]) * 1e3
    seen_error_mm = seen_mm - np.interp(seen_s, truth.t_s, truth.displacement_m) * 1e3

    figure, (stroke, deviation, speed, burst) = pyplot.subplots(
        4, 1, sharex=True, figsize=(10, 10), height_ratios=(3, 2, 1.6, 1.6), layout="constrained"
    )
    stroke.plot(seen_s, seen_mm, ".", color=GREY, markersize=2, label="reported by the controller (CAN)")
    stroke.plot(t_s, true_mm, color="black", linewidth=2.5, label="truth")
    stroke.plot(t_s, p_mm, color=BLUE, linewidth=1.2, label="ramstroke")
    stroke.set_ylabel("stroke [mm]")
    stroke.set_title("One cycle of the virtual roof support: push and retract")

    deviation.plot(seen_s, seen_error_mm, ".", color=GREY, markersize=2, label="CAN − truth")
    deviation.fill_between(
        t_s, -1.96 * sigma_mm, 1.96 * sigma_mm, color=BLUE, alpha=0.15, linewidth=0, label="stated 95 %"
    )
    deviation.plot(t_s, p_mm - true_mm, color=BLUE, linewidth=1.2, label="ramstroke − truth")
    deviation.set_ylabel("error [mm]")

    speed.plot(t_s, np.interp(t_s, truth.t_s, truth.velocity_m_s) * 1e3, color="black", linewidth=0.6, label="truth")
    speed.plot(t_s, [e.velocity_m_s * 1e3 for e in settled], color=BLUE, linewidth=1.0, label="ramstroke")
    speed.set_ylabel("speed [mm/s]")

    burst.plot(t_s, [e.acceleration_m_s2 for e in settled], color=BLUE, linewidth=0.4, label="levelled push axis")
    for limit in ("chart_lower_m_s2", "chart_upper_m_s2"):
        burst.plot(t_s, [getattr(e, limit) for e in settled], color=VERMILION, linewidth=0.9)
    burst.set_ylabel("acceleration [m/s²]")
    burst.set_xlabel("time [s]; orange: varying velocity (VVS), green: constant velocity (CVS)")

    places = {stroke: "upper left", deviation: "upper right", speed: "lower left", burst: "upper left"}
    for axes, place in places.items():
        _shade_segments(axes, settled)
        axes.margins(x=0)
        axes.grid(alpha=0.3)
        axes.legend(loc=place, fontsize=8)
    try:
        save_picture(figure, path)
    except OSError as problem:
        raise PlotError(f"cannot write {path}: {problem.strerror or problem}") from problem
    finally:
        pyplot.close(figure)


def _shade_segments(axes: Axes, settled: Sequence[Estimate]) -> None:
    begin = 0
    for i in range(1, len(settled) + 1):
        if i == len(settled) or settled[i].segment is not settled[begin].segment:
            colour = SEGMENT_COLOURS.get(settled[begin].segment)
            if colour is not None:
                end_ns = settled[min(i, len(settled) - 1)].t_ns
                axes.axvspan(settled[begin].t_ns * 1e-9, end_ns * 1e-9, color=colour, alpha=0.18, linewidth=0)
            begin = i
