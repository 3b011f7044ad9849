"""Pictures of tuning: the papers' figures from our own runs, and a recording's objective."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from daemon.offline.pictures import save_picture
from daemon.offline.plots import BLUE, GREEN, GREY, ORANGE, VERMILION
from daemon.offline.tuning.benchmark import BUDGET, Row
from estimation.arrays import FloatArray
from estimation.tuning.artificial import ARTIFICIAL, observed
from estimation.tuning.functions import FUNCTIONS
from estimation.tuning.observed import Observed
from estimation.tuning.search import Found
from estimation.tuning.two_state_pass import estimate
from estimation.tuning.two_state_tuning import Tuned, fit, tune

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NAMES = {"foa": "FOA", "foa3d": "3D-FOA", "ifoa_a": "IFOA", "ga": "GA", "pso": "PSO", "gfoa": "GFOA", "ifoa_b": "IFOA"}
COLOURS = {
    "foa": ORANGE,
    "foa3d": GREEN,
    "ifoa_a": BLUE,
    "ga": VERMILION,
    "pso": GREY,
    "gfoa": GREEN,
    "ifoa_b": VERMILION,
    "multistart": BLUE,
    "de": "#CC79A7",
    "nelder_mead": "black",
}
FLIES_OF_A = ("foa", "foa3d", "ifoa_a")
RIVALS_OF_A = ("ga", "pso")
SPAN_DECADES = 4.0  # of q/r shown to either side of the best
LEAST_SHOWN = 1e-16  # of an excess on a logarithmic axis


def _figure(rows: int, columns: int, title: str) -> tuple[Figure, list[Axes]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5 * columns, 1.0 + 3.2 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    return figure, list(figure.subplots(rows, columns, squeeze=False).flat)


def _save(figure: Figure, path: Path) -> Path:
    for one in figure.axes:
        one.grid(alpha=0.3)
        one.margins(x=0)
        if one.get_legend_handles_labels()[0]:
            one.legend(fontsize=7)
    save_picture(figure, path)
    return path


def draw_paper_a(folder: Path, scenario: str = "AS-1", seed: int = 0) -> list[Path]:
    """Figures 7 and 8 of paper A: the artificial signal's distance and the errors, by five tuners."""
    case = ARTIFICIAL[scenario]
    motion = observed(case, seed)
    t_s = case.dt_s * np.arange(1, case.n)
    truth = motion.truth if motion.truth is not None else motion.y
    tuned = {name: tune([motion], case.form, name, "truth", seed, BUDGET) for name in (*FLIES_OF_A, *RIVALS_OF_A)}
    courses = {name: estimate(motion, one.q / one.r) for name, one in tuned.items()}
    drawn = []
    for number, what in ((7, "distance"), (8, "error")):
        figure, axes = _figure(1, 1, f"paper A, figure {number}, {scenario}, seed {seed}: {what} by tuner")
        inset = axes[0].inset_axes((0.58, 0.08, 0.4, 0.36))
        for one, names in ((axes[0], FLIES_OF_A), (inset, RIVALS_OF_A)):
            if what == "distance":
                one.plot(t_s, truth, color="black", linewidth=2.0, label="truth")
            for name in names:
                values = courses[name] if what == "distance" else courses[name] - truth
                mse = float(np.mean((courses[name] - truth) ** 2))
                one.plot(t_s, values, color=COLOURS[name], linewidth=0.8, label=f"{NAMES[name]}, MSE {mse:.4f}")
        inset.tick_params(labelsize=6)
        inset.legend(fontsize=6)
        axes[0].set_xlabel("time [s]")
        axes[0].set_ylabel(f"{what} [length unit]")
        if what == "error":
            low, high = axes[0].get_ylim()
            axes[0].set_ylim(low - 1.2 * (high - low), high)  # room for the inset
        drawn.append(_save(figure, folder / f"paper-a-{number}.png"))
    return drawn


def draw_functions(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Figure 4 of paper B: best value so far against the evaluations, median over the seeds, a panel per function."""
    drawn = []
    for variant in dict.fromkeys(row.variant for row in rows):
        figure, axes = _figure(2, 3, f"paper B, figure 4, {variant} functions: best value so far, over the optimum")
        for one, (name, function) in zip(axes, FUNCTIONS.items(), strict=True):
            of_panel = [row for row in rows if row.problem == name and row.variant == variant]
            for method in dict.fromkeys(row.method for row in of_panel):
                curves = [_excess_curve(row) for row in of_panel if row.method == method]
                median = np.maximum(np.median(curves, axis=0), LEAST_SHOWN)
                one.loglog(np.arange(1, BUDGET + 1), median, color=COLOURS.get(method), label=NAMES.get(method, method))
            one.set_title(function.title)
            one.set_xlabel("evaluations")
        axes[0].set_ylabel("best − optimum")
        drawn.append(_save(figure, folder / f"paper-b-4-{variant}.png"))
    return drawn


def _excess_curve(row: Row) -> FloatArray:
    """Best value less the optimum after each of `BUDGET` evaluations; infinite before the first finite one."""
    curve = np.full(BUDGET, np.inf)
    for evaluations, value in row.history:
        curve[evaluations - 1 :] = value - row.optimum
    return curve


def draw_artificial(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Excess over the true optimum by scenario and method, one dot a seed."""
    figure, axes = _figure(2, 3, "mean squared error over the true optimum's, one dot a seed")
    for one, name in zip(axes, ARTIFICIAL, strict=True):
        of_panel = [row for row in rows if row.problem == name]
        methods = list(dict.fromkeys(row.method for row in of_panel))
        for place, method in enumerate(methods):
            excess = [max(row.excess, LEAST_SHOWN) for row in of_panel if row.method == method]
            one.plot(excess, [place] * len(excess), ".", color=COLOURS.get(method, BLUE), markersize=4)
        one.set_yticks(range(len(methods)), methods, fontsize=7)
        one.invert_yaxis()
        one.set_xscale("log")
        one.set_title(f"{name}: {ARTIFICIAL[name].about}")
        one.set_xlabel("relative excess")
    return [_save(figure, folder / "tuning-artificial.png")]


def draw_tuning(motions: Sequence[Observed], tuned: Tuned, folder: Path) -> list[Path]:
    """A recording's objective over log10(q/r) with the best and its interval, and how the search went."""
    figure, (landscape, course) = _figure(1, 2, f"tuning by {tuned.method}, objective {tuned.goal}")
    ratios = np.linspace(tuned.log10_ratio - SPAN_DECADES, tuned.log10_ratio + SPAN_DECADES, 161)
    sums = fit(motions, 10.0**ratios)
    if tuned.goal == "ml":
        landscape.plot(ratios, sums.deviance - sums.deviance.min(), color=BLUE)
        landscape.set_ylabel("deviance over its least")
        landscape.set_yscale("symlog", linthresh=10.0)
        landscape.axhline(9.0, color=GREY, linestyle=":", label="3 sigma")
    else:
        landscape.semilogy(ratios, sums.mse, color=BLUE)
        landscape.set_ylabel("mean squared error")
    landscape.axvline(tuned.log10_ratio, color=VERMILION, label=f"best: {tuned.log10_ratio:.2f}")
    if tuned.interval is not None:
        low, high = np.clip(tuned.interval, ratios[0], ratios[-1])
        landscape.axvspan(low, high, color=VERMILION, alpha=0.15, linewidth=0)
    landscape.set_xlabel("log10(q/r)")
    _draw_course(course, tuned.history)
    return [_save(figure, folder / "tuning.png")]


def draw_search(found: Found, folder: Path) -> list[Path]:
    """How a search went."""
    figure, (course,) = _figure(1, 1, "process noises of our estimator")
    _draw_course(course, found.history)
    return [_save(figure, folder / "tuning.png")]


def _draw_course(one: Axes, history: Sequence[tuple[int, float]]) -> None:
    used, values = np.array(history).T
    one.step(used, values, where="post", color=BLUE, marker=".")
    one.set_xlabel("evaluations")
    one.set_ylabel("best value so far")
