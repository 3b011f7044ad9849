"""Pictures of an evaluation: how large the errors are beside the clock's, and whether the stated sigmas are true."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from daemon.extras import needs
from daemon.offline.evaluation.score import SIGMAS_95, MoveScore, SeedResult
from daemon.offline.evaluation.summary import row_names
from daemon.offline.pictures import save_picture
from daemon.offline.plots import BLUE, GREY, ORANGE, PlotError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {"fused": BLUE, "inertial": ORANGE}
LEAST_MM = 0.01  # smaller errors are drawn there: a logarithm knows no zero
SIGMAS_SHOWN = 4.0


def require_matplotlib() -> None:
    """Raises PlotError where nothing can be drawn."""
    if find_spec("matplotlib") is None:
        raise PlotError(needs("a plot", "matplotlib", "offline"))


def plot_evaluation(results: list[SeedResult], folder: Path) -> Path:
    """One picture of one scenario, a row for each judged move; returns where it is."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    scenario, warm = results[0].case.scenario, results[0].case.warm_up
    names = row_names(scenario)
    modes = list(dict.fromkeys(result.case.mode for result in results))
    good = [result for result in results if not result.failure]
    figure = Figure(figsize=(14.0, 0.8 + 3.6 * len(names)), layout="constrained")
    FigureCanvasAgg(figure)
    right = ", ".join(
        f"{mode} {sum(r.case.mode == mode for r in good)} of {sum(r.case.mode == mode for r in results)}"
        for mode in modes
    )
    figure.suptitle(f"{scenario}: records with every move right: {right}; {warm} cycles learned from before")
    for index, (name, axes) in enumerate(zip(names, figure.subplots(len(names), 3, squeeze=False), strict=True)):
        scores = {
            mode: [r.moves[index] for r in good if r.case.mode == mode and r.moves[index] is not None] for mode in modes
        }
        told = {mode: [score for score in of_mode if score is not None] for mode, of_mode in scores.items()}
        clock = [r.clock_errors_mm[index] for r in good if r.case.mode == modes[0]]
        _draw_errors(axes[0], name, told, clock)
        _draw_honesty(axes[1], name, told)
        _draw_times(axes[2], name, told)
    path = folder / f"{scenario}.png"
    save_picture(figure, path)
    return path


def _draw_errors(axes: Axes, name: str, told: dict[str, list[MoveScore]], clock: list[float]) -> None:
    for mode, scores in told.items():
        _distribution(axes, np.maximum(np.abs([s.error_mm for s in scores]), LEAST_MM), COLOURS[mode], "-", mode)
    _distribution(axes, np.maximum(np.abs(clock), LEAST_MM), GREY, "--", "clock")
    axes.set(title=f"{name}: error at its end, before any stop", xscale="log", xlabel="|error| [mm]")
    axes.set_xlim(LEAST_MM, 100.0)
    _finish(axes)


def _draw_honesty(axes: Axes, name: str, told: dict[str, list[MoveScore]]) -> None:
    for mode, scores in told.items():
        for tier, style in (("provisional", ":"), ("settled", "-")):
            instants = [s.provisional if tier == "provisional" else s.settled for s in scores]
            sigmas = np.abs([instant.error_mm / instant.sigma_mm for instant in instants])
            if sigmas.size:
                holds, nees = np.mean(sigmas <= SIGMAS_95), np.mean(sigmas**2)
                label = f"{mode}, {tier}: 95 % holds {holds:.2f}, NEES {nees:.2f}"
                _distribution(axes, np.minimum(sigmas, SIGMAS_SHOWN), COLOURS[mode], style, label)
    sizes = np.linspace(0.0, SIGMAS_SHOWN, 100)
    expected = [2.0 * NormalDist().cdf(size) - 1.0 for size in sizes]
    axes.plot(sizes, expected, color="black", linewidth=1.0, label="honest sigma (right of it: too small)")
    axes.set(title=f"{name}: error at a random instant over its stated sigma", xlabel="|error| / sigma")
    axes.set_xlim(0.0, SIGMAS_SHOWN)
    _finish(axes)


def _draw_times(axes: Axes, name: str, told: dict[str, list[MoveScore]]) -> None:
    for mode, scores in told.items():
        for what, style, values in (
            ("onset", "-", [s.onset_error_ms for s in scores]),
            ("stop", "--", [s.stop_error_ms for s in scores]),
        ):
            _distribution(axes, np.array(values), COLOURS[mode], style, f"{mode}, {what}")
    if axes.lines:
        axes.axvline(0.0, color="black", linewidth=0.8)
    else:
        axes.text(0.5, 0.5, "none found in a right record", ha="center", transform=axes.transAxes)
        axes.set_xticks([])
    axes.set(title=f"{name}: onset and stop", xlabel="found − true [ms]")
    _finish(axes)


def _distribution(axes: Axes, values: np.ndarray, colour: str, style: str, label: str) -> None:
    known = values[np.isfinite(values)]
    if known.size:
        axes.ecdf(known, color=colour, linestyle=style, label=label)


def _finish(axes: Axes) -> None:
    axes.set(ylabel="share of moves below", ylim=(0.0, 1.02))
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=7)
