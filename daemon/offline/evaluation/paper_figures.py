"""The papers' figures from our own data: the same panels, the same quantities."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from daemon.offline.evaluation.methods import Played, play
from daemon.offline.pictures import save_picture
from daemon.offline.plots import BLUE, GREEN, GREY, ORANGE, VERMILION
from estimation.arrays import FloatArray
from estimation.methods.batch import Course
from estimation.methods.chart import change_points, printed_limits
from estimation.methods.clusters import by_gaps, k_means
from estimation.methods.integrate import integral
from estimation.methods.paper_c import Reading
from estimation.methods.registry import METHODS
from estimation.methods.wavelet import filtered

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BURST_S = 1.0  # of a start, as drawn
REST_S = 5.0  # at the beginning


def draw_figures(scenario: str, seed: int, folder: Path) -> list[Path]:
    """Figures 9B, 10 and 11 of paper A and 3 to 6 of paper C, of one virtual support; returns where they are."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    played = play(scenario, seed)
    drawn: list[Path] = []
    figures: tuple[tuple[str, int, int, Callable[[Played, Sequence[Axes]], None]], ...] = (
        ("paper-a-9b", 3, 1, _a9),
        ("paper-a-10", 1, 2, _a10),
        ("paper-a-11", 1, 1, _a11),
        ("paper-c-3", 3, 2, _c3),
        ("paper-c-4", 3, 1, _c4),
        ("paper-c-5", 2, 2, _c5),
        ("paper-c-6", 2, 2, _c6),
    )
    for name, rows, columns, draw in figures:
        figure: Figure = Figure(figsize=(6.0 * columns, 1.0 + 2.6 * rows), layout="constrained")
        FigureCanvasAgg(figure)
        axes = list(figure.subplots(rows, columns, squeeze=False).flat)
        figure.suptitle(f"{name.replace('-', ' ')}, {scenario}, seed {seed}")
        draw(played, axes)
        for one in axes:
            one.grid(alpha=0.3)
            one.margins(x=0)
            if one.get_legend_handles_labels()[0]:
                one.legend(fontsize=7)
        drawn.append(folder / f"{scenario}-{name}.png")
        save_picture(figure, drawn[-1])
    return drawn


# --- paper A ----------------------------------------------------------------------------------------------------------


def _truth(played: Played) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, displacement [mm] and velocity [mm/s] of the truth on the record's clock."""
    at = played.judged
    t_s = at.trajectory.t_s + at.start_s - played.batch.first_ns * 1e-9
    return t_s, at.trajectory.displacement_m * 1e3, at.trajectory.velocity_m_s * 1e3


def _push_only(played: Played, axes: Sequence[Axes]) -> tuple[float, float]:
    """The time of the push, shown by all axes."""
    push = played.judged.trajectory.moves[0]
    begin_s, end_s = push.onset_s - 2.0, push.stop_s + 3.0
    for one in axes:
        one.set_xlim(begin_s, end_s)
        one.set_xlabel("time [s]")
    return begin_s, end_s


def _a9(played: Played, axes: Sequence[Axes]) -> None:
    """Theoretical beside measured: distance, velocity, acceleration."""
    batch, push = played.batch, played.judged.trajectory.moves[0]
    t_s, p_mm, v_mm_s = _truth(played)
    even = batch.nominal_speed(1) * np.clip(batch.t_s - push.onset_s, 0.0, push.stop_s - push.onset_s) * 1e3
    axes[0].plot(t_s, p_mm, color="black", label="measured (laboratory sensor)")
    axes[0].plot(batch.t_s, even, color=ORANGE, linestyle="--", label="theoretical")
    axes[0].set_ylabel("distance [mm]")
    moving = (batch.t_s >= push.onset_s) & (batch.t_s < push.stop_s)
    axes[1].plot(t_s, v_mm_s, color="black", linewidth=0.6, label="measured (its derivative)")
    axes[1].plot(batch.t_s, np.where(moving, batch.nominal_speed(1) * 1e3, 0.0), color=ORANGE, linestyle="--")
    axes[1].set_ylabel("velocity [mm/s]")
    axes[2].plot(batch.t_s, batch.accel[:, 1], color=GREY, linewidth=0.3, label="measured (inertial sensor)")
    axes[2].axhline(0.0, color=ORANGE, linestyle="--", label="theoretical, but for the bursts")
    axes[2].set_ylabel("acceleration [m/s²]")
    _push_only(played, axes)


def _a10(played: Played, axes: Sequence[Axes]) -> None:
    """The whole push and its end: real, integrated without a filter, filtered."""
    batch = played.batch
    t_s, p_mm, _ = _truth(played)
    plain, kalman = _course(played, "integrate"), _course(played, "kf2-tuned")
    for one in axes:
        one.plot(t_s, p_mm, color="black", label="real distance")
        one.plot(batch.t_s, plain.displacement_m * 1e3, color=BLUE, label="integrated twice, no filter")
        one.plot(batch.t_s, kalman.displacement_m * 1e3, color=GREEN, label="two-state Kalman filter, tuned")
        one.set_ylabel("distance [mm]")
    axes[0].set_ylim(-100.0, 800.0)
    push = played.judged.trajectory.moves[0]
    _push_only(played, axes)
    axes[1].set_xlim(push.stop_s - 3.0, push.stop_s + 2.0)
    axes[1].set_ylim(push.end_m * 1e3 - 60.0, push.end_m * 1e3 + 25.0)
    axes[1].set_title("final stage")


def _a11(played: Played, axes: Sequence[Axes]) -> None:
    """Error of the measurement and of the filter."""
    batch = played.batch
    t_s, p_mm, _ = _truth(played)
    kalman = _course(played, "kf2-tuned")
    seen = batch.seen_m * 1e3 - np.interp(batch.seen_s, t_s, p_mm)
    error = kalman.displacement_m * 1e3 - np.interp(batch.t_s, t_s, p_mm)
    push = played.judged.trajectory.moves[0]
    during_seen = (batch.seen_s > push.onset_s) & (batch.seen_s < push.stop_s + 1.0)
    during = (batch.t_s > push.onset_s) & (batch.t_s < push.stop_s + 1.0)
    worst_seen, worst = (float(np.abs(values).max()) for values in (seen[during_seen], error[during]))
    axes[0].plot(batch.seen_s, seen, ".", color=GREY, markersize=3, label=f"measured, at most {worst_seen:.1f} mm")
    axes[0].plot(batch.t_s, error, color=GREEN, label=f"two-state Kalman filter, tuned, at most {worst:.1f} mm")
    axes[0].set_ylabel("error [mm]")
    axes[0].set_ylim(-25.0, 25.0)
    _push_only(played, axes)


# --- paper C ----------------------------------------------------------------------------------------------------------


def _c3(played: Played, axes: Sequence[Axes]) -> None:
    """Raw acceleration along y and x with the displacement, what was removed, what is left."""
    batch, reading = played.batch, Reading()
    t_s, p_mm, _ = _truth(played)
    kept = filtered(batch.accel, reading.level, reading.wavelet)
    for column, (axis, name) in enumerate(((1, "y"), (0, "x"))):
        raw = batch.accel[:, axis]
        for row, (values, what) in enumerate(
            ((raw, "raw"), (raw - kept[:, axis], "removed: drift and noise"), (kept[:, axis], "filtered"))
        ):
            one = axes[2 * row + column]
            one.plot(batch.t_s, values, color=BLUE, linewidth=0.3, label=f"{what}, {name}")
            one.set_ylabel("acceleration [m/s²]")
            if row != 1:
                beside = one.twinx()
                beside.plot(t_s, p_mm, color="black", linewidth=0.8)
                beside.set_ylabel("displacement [mm]")
            one.set_xlabel("time [s]")


def _c4(played: Played, axes: Sequence[Axes]) -> None:
    """Chart and change points, their clusters with k = 5 and k = 4."""
    batch, reading = played.batch, Reading()
    y = filtered(batch.accel, reading.level, reading.wavelet)[:, 1]
    # The sensor's own filter makes successive values alike: their range says too little of the spread.
    reach = 5.0 * float(y[batch.t_s < REST_S].std())
    limits, printed = (-reach, reach), printed_limits(y)
    bursts = by_gaps(change_points(y, limits), batch.t_s)
    points = change_points(y, limits)
    points = points[[any(first <= point <= last for first, last in bursts) for point in points]]
    axes[0].plot(batch.t_s, y, color=GREY, linewidth=0.3, label="filtered acceleration")
    axes[0].plot(
        batch.t_s[points], y[points], ".", color=VERMILION, markersize=2, label="change points, stray ones left out"
    )
    for place, limit in enumerate(limits):
        label = "LCL, UCL: 5 standard deviations at rest" if place else None
        axes[0].axhline(limit, color=BLUE, linewidth=0.9, label=label)
    share = len(change_points(y, printed)) / len(y)
    axes[0].set_title(f"(as printed {printed[1] - printed[0]:.0e} m/s² apart: {share:.0%} change points)", fontsize=9)
    for one, k in zip(axes[1:], (5, 4), strict=True):
        one.plot(batch.t_s, y, color=GREY, linewidth=0.3)
        for number, (first, last) in enumerate(k_means(points, k) if len(points) >= k else ()):
            colour = (BLUE, ORANGE, GREEN, VERMILION, "#CC79A7")[number]
            one.axvspan(batch.t_s[first], batch.t_s[last], color=colour, alpha=0.3, linewidth=0)
        one.set_title(f"clusters of the change points, k = {k}")
    for one in axes:
        one.set_ylabel("[m/s²]")
        one.set_xlabel("time [s]")


def _c5(played: Played, axes: Sequence[Axes]) -> None:
    """The start burst of the push: acceleration, velocity, displacement, error."""
    push = played.judged.trajectory.moves[0]
    _segment(played, axes, push.onset_s, push.onset_s + BURST_S)


def _c6(played: Played, axes: Sequence[Axes]) -> None:
    """The constant-velocity segment of the push."""
    push = played.judged.trajectory.moves[0]
    _segment(played, axes, push.onset_s + BURST_S, push.stop_s)


def _segment(played: Played, axes: Sequence[Axes], begin_s: float, end_s: float) -> None:
    """Acceleration, velocity, displacement and error in one segment; green: direct integration from its beginning."""
    batch = played.batch
    corrected, direct = _course(played, "mskf-corrected"), _course(played, "integrate")
    t_s, p_mm, v_mm_s = _truth(played)
    inside = slice(*(int(i) for i in np.searchsorted(batch.t_s, (begin_s, end_s))))
    t = batch.t_s[inside]
    true_p, true_v = np.interp(t, t_s, p_mm), np.interp(t, t_s, v_mm_s)
    direct_v = corrected.velocity_m_s[inside.start] * 1e3 + integral(direct.acceleration_m_s2[inside] * 1e3, t)
    p_now = corrected.displacement_m[inside] * 1e3
    direct_p = p_now[0] + integral(direct_v, t)
    axes[0].plot(t, corrected.acceleration_m_s2[inside] * 1e3, color=BLUE, linewidth=0.6, label="estimated")
    axes[0].set_ylabel("acceleration [mm/s²]")
    for one, ours, plain, true, name in (
        (axes[1], corrected.velocity_m_s[inside] * 1e3, direct_v, true_v, "velocity [mm/s]"),
        (axes[2], p_now, direct_p, true_p, "displacement [mm]"),
    ):
        one.plot(t, true, color="black", linewidth=0.8, label="truth")
        one.plot(t, plain, color=GREEN, label="direct integration")
        one.plot(t, ours, color=BLUE, label="mskf-corrected")
        one.set_ylabel(name)
    axes[3].plot(t, direct_p - true_p, color=GREEN, label="direct integration")
    axes[3].plot(t, p_now - true_p, color=BLUE, label="mskf-corrected")
    axes[3].set_ylabel("error [mm]")
    for one in axes:
        one.set_xlabel("time [s]")


def _course(played: Played, method: str) -> Course:
    course_of = METHODS[method].course
    assert course_of is not None
    return course_of(played.batch)
