"""Pictures of an evaluation: how large the errors are beside the clock's, and whether the stated sigmas are true."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from daemon.offline.evaluation import SeedResult, row_names


def plot_evaluation(results: list[SeedResult], folder: Path) -> Path:
    """One picture of one scenario, a row for each judged move; returns where it is."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from scipy.stats import norm

    scenario = results[0].case.scenario
    names = row_names(scenario)
    modes = list(dict.fromkeys(result.case.mode for result in results))
    good = [result for result in results if not result.failure]
    figure = Figure(figsize=(13.0, 1.2 + 3.0 * len(names)), layout="constrained")
    FigureCanvasAgg(figure)
    warm = results[0].case.warm_up
    figure.suptitle(f"{scenario}: {len(results)} records, {len(results) - len(good)} failed, {warm} cycles before")
    axes = figure.subplots(len(names), 3, squeeze=False)
    for index, name in enumerate(names):
        errors, stated, times = axes[index]
        for mode, colour in zip(modes, ("tab:blue", "tab:orange"), strict=False):
            scores = [result.moves[index] for result in good if result.case.mode == mode]
            if not scores:
                continue
            share = (np.arange(len(scores)) + 0.5) / len(scores)
            errors.semilogx(np.sort(np.abs([s.error_mm for s in scores])) + 1e-3, share, color=colour, label=mode)
            quantiles = norm.ppf(share)
            for label, values, style in (
                ("end of the move", [s.error_mm / s.sigma_mm for s in scores], "o"),
                ("provisional", [s.provisional.error_mm / s.provisional.sigma_mm for s in scores], "x"),
                ("settled", [s.settled.error_mm / s.settled.sigma_mm for s in scores], "."),
            ):
                stated.plot(quantiles, np.sort(values), style, color=colour, ms=4, label=f"{mode}, {label}")
            onsets, stops = [s.onset_error_ms for s in scores], [s.stop_error_ms for s in scores]
            times.plot(onsets, stops, ".", color=colour, label=mode)
        clock = [result.clock_errors_mm[index] for result in good if result.case.mode == modes[0]]
        if clock:
            share = (np.arange(len(clock)) + 0.5) / len(clock)
            errors.semilogx(np.sort(np.abs(clock)) + 1e-3, share, color="grey", ls="--", label="clock")
        errors.set(title=f"{name}: error at its end, before any stop", xlabel="mm", ylabel="share of records below")
        stated.axline((0, 0), slope=1, color="black", lw=0.8)
        stated.set(title="error in stated sigmas", xlabel="sigmas, if what is stated were true", ylabel="sigmas found")
        times.axhline(0, color="black", lw=0.8)
        times.axvline(0, color="black", lw=0.8)
        times.set(title="errors of the times", xlabel="onset, ms", ylabel="stop, ms")
        for axis in (errors, stated):
            axis.grid(alpha=0.3)
            axis.legend(fontsize=7)
    path = folder / f"{scenario}.png"
    figure.savefig(path, dpi=110)
    return path
