"""Figures 5 and 7 of paper B from our own virtual sensors: errors over 5 s, angles over 50 s, by method."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from daemon.offline.alignment.tuning import AS_PRINTED, AXES, PRINTED_NAME, Tuned
from daemon.offline.pictures import save_picture
from daemon.offline.plots import BLUE, GREEN, GREY, ORANGE, VERMILION
from estimation.alignment.attitude import to_angles
from estimation.alignment.candidates import Records
from estimation.alignment.scenarios import STEP_S
from estimation.alignment.search import OURS
from estimation.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {OURS: BLUE, "pso": GREY, "foa": ORANGE, "gfoa": GREEN, "ifoa_b": VERMILION}
DASHES = {"gfoa": (0, (4, 2)), "ifoa_b": (0, (2, 1))}  # lines that lie on each other stay visible
RUN = 0
ZOOM_SIGMAS = 4.0
SETTLED = 10  # steps: the first second, in which the level comes from its prior, may leave the picture


def draw_figure_5(tuned: Sequence[Tuned], seed: int, folder: Path) -> Path:
    """Errors of one run against time: on the left all of them, on the right the scale of the best."""
    figure, axes = figure_of(
        2, f"paper B, figure 5: error of a virtual sensor at rest by process noise, AL-8, seed {seed}"
    )
    shown = [one for one in tuned if one.method in AS_PRINTED] or list(tuned)
    for i, (axis, (whole, close)) in enumerate(zip(AXES, axes, strict=True)):
        for one in (whole, close):
            one.axhline(0.0, color="black", linewidth=0.8)
            for method in shown:
                _line(one, method, np.degrees(method.course[:, RUN, i]))
                if method.method == OURS:
                    sigma = np.degrees(method.sigma[:, i])
                    _band(one, -sigma, sigma, "ours: stated ± 1σ")
        whole.set_ylabel(f"{axis} error [deg]")
        errors = np.degrees(np.array([method.course[:, RUN, i] for method in shown]))
        if axis == "yaw":
            close.set_ylim(*around(errors))
        elif shown[0].method == OURS:
            reach = ZOOM_SIGMAS * float(np.degrees(shown[0].sigma[-1, i]))
            close.set_ylim(-reach, reach)
    axes[0][0].set_title("everything", fontsize=9)
    axes[0][1].set_title(f"the same, enlarged: ± {ZOOM_SIGMAS:g}σ", fontsize=9)
    axes[2][0].set_title("yaw is not observed in 5 s: the error stays what it was", fontsize=9)
    axes[2][1].set_title("the same, enlarged to the lines", fontsize=9)
    return save(figure, axes, folder / "paper-b-5.png")


def draw_figure_7(records: Records, tuned: Sequence[Tuned], seed: int, folder: Path) -> Path:
    """Angles of one resting sensor against time, with its true attitude."""
    figure, axes = figure_of(1, f"paper B, figure 7: angles of a virtual JY901 at rest by process noise, seed {seed}")
    true = np.degrees(np.stack(to_angles(records.sensors.true), axis=-1)[RUN])
    for i, (axis, (one,)) in enumerate(zip(AXES, axes, strict=True)):
        one.axhline(true[i], color="black", linewidth=1.5, label="truth", zorder=4)
        settled = [true[[i]]]
        for method in tuned:
            angle = true[i] + np.degrees(method.course[:, RUN, i])
            settled.append(angle[SETTLED:])
            _line(one, method, angle)
            if method.method == OURS:
                sigma = np.degrees(method.sigma[:, i])
                settled += [angle[SETTLED:] - sigma[SETTLED:], angle[SETTLED:] + sigma[SETTLED:]]
                _band(one, angle - sigma, angle + sigma, "ours: stated ± 1σ")
        one.set_ylim(*around(np.concatenate(settled)))
        one.set_ylabel(f"{axis} [deg]")
    axes[0][0].set_title("level: the band is the accelerometers' bias of 10 mg, which rest does not show", fontsize=9)
    axes[2][0].set_title("yaw: refused, it stays the survey's and drifts with the gyroscopes' bias", fontsize=9)
    return save(figure, axes, folder / "paper-b-7.png")


def around(values: FloatArray) -> tuple[float, float]:
    """Limits of an axis that shows all of them."""
    low, high = float(values.min()), float(values.max())
    margin = 0.05 * (high - low) or 1e-6
    return low - margin, high + margin


def figure_of(columns: int, title: str) -> tuple[Figure, list[list[Axes]]]:
    """One row for each angle."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.0 + 4.5 * columns, 9.0), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    return figure, [list(row) for row in figure.subplots(len(AXES), columns, sharex=True, squeeze=False)]


def _line(axes: Axes, tuned: Tuned, values: FloatArray) -> None:
    q = "the sensor's random walk" if tuned.s is None else f"Q = {tuned.s[RUN]:.1e}"
    t_s = STEP_S * np.arange(1, len(values) + 1)
    axes.plot(
        t_s,
        values,
        color=COLOURS.get(tuned.method, VERMILION),
        linestyle=DASHES.get(tuned.method, "-"),
        linewidth=1.8 if tuned.method == OURS else 1.0,
        zorder=3 if tuned.method == OURS else 2,
        label=f"{PRINTED_NAME.get(tuned.method, tuned.method)}: {q}",
    )


def _band(axes: Axes, low: FloatArray, high: FloatArray, label: str) -> None:
    t_s = STEP_S * np.arange(1, len(low) + 1)
    axes.fill_between(t_s, low, high, color=BLUE, alpha=0.15, linewidth=0, label=label)


def save(figure: Figure, axes: list[list[Axes]], path: Path) -> Path:
    """With grid, legend and time below."""
    for one in figure.axes:
        one.grid(alpha=0.3)
        one.margins(x=0)
    for one in axes[-1]:
        one.set_xlabel("time [s]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    save_picture(figure, path)
    return path
