"""`ramstroke align --benchmark`: virtual sensors at rest beside what theory allows and paper B prints."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daemon.commands import align_tables, choices

if TYPE_CHECKING:
    from daemon.offline.alignment.tuning import Tuned
    from estimation.alignment.scenarios import Alignment

TUNED_SHARE = 10  # of --runs one in ten is tuned on: a search is 2,000 alignments
NOTE = (
    "Level errors of 4 to 6e-5 rad are what an accelerometer bias of 50 ug leaves (AL-1, AL-8). A yaw of 2.4e-7 in "
    "5 s is beyond any sensor: in that time yaw stays at its prior, and in 50 s a navigation-grade one knows it to "
    "0.13 deg. It can only be the simulated initial error. Tuning Q finds no bias that rest cannot show: the right Q "
    "is the sensor's random walk."
)


def run(arguments: argparse.Namespace) -> int:
    """All settings, then the tuners, or the one that is named."""
    from daemon import terminal
    from daemon.errors import UsageError
    from daemon.offline.alignment.benchmark import PRINTED, benchmark
    from daemon.offline.alignment.tuning import (
        GENERATIONS,
        METHODS,
        SIMULATION,
        experiment_rows,
        records_of,
        simulation_rows,
        tune_all,
    )

    for name, used in (("a recording", arguments.file), ("--live", arguments.live), ("--save", arguments.save)):
        if used:
            raise UsageError(f"--benchmark makes its own data: {name} does not go with it")
    if arguments.runs < 2:
        raise UsageError("--runs must be at least 2")
    if arguments.seed < 0:
        raise UsageError("--seed must not be negative")
    chosen = tuple(METHODS)
    if arguments.method is not None:
        chosen = (choices.known("--method", arguments.method, METHODS),)
    if arguments.plot is not None:
        choices.picture_folder("--plot", arguments.plot)
    with terminal.progress("settings", 9) as progress:
        rows = benchmark(arguments.runs, arguments.seed, progress)
    records = records_of(SIMULATION, max(2, arguments.runs // TUNED_SHARE), arguments.seed)
    with terminal.progress("generations of the tuners", GENERATIONS) as progress:
        tuned = tune_all(records, chosen, arguments.seed, progress)
    experiment = experiment_rows(arguments.runs, arguments.seed)
    drawn = [] if arguments.plot is None else _draw(tuned, chosen, arguments.seed, arguments.plot)
    if arguments.json:
        told = {"rows": rows, "printed": PRINTED, "tuned": simulation_rows(tuned), "experiment": experiment}
        terminal.print_json(told)
        return 0
    _print_settings(rows, arguments.runs)
    _print_tuned(simulation_rows(tuned))
    _print_experiment(experiment)
    terminal.say(NOTE)
    for path in drawn:
        terminal.say(f"Picture: {path}")
    return 0


def methods() -> dict[str, str]:
    """Those of the benchmark, and what they do."""
    from daemon.offline.alignment.tuning import METHODS

    return METHODS


def print_methods() -> None:
    """Those of the benchmark."""
    from daemon import terminal

    made = terminal.table("Methods of --benchmark", "process noise by", "what")
    made.columns[1].justify = "left"
    for name, about in methods().items():
        made.add_row(name, about)
    terminal.OUT.print(made)


def _draw(tuned: list[Tuned], methods: tuple[str, ...], seed: int, folder: Path) -> list[Path]:
    """Figure 7 has the methods that paper B prints, tuned on its own record."""
    from daemon import terminal
    from daemon.offline.alignment.paper_figures import draw_figure_5, draw_figure_7
    from daemon.offline.alignment.tuning import AS_PRINTED, GENERATIONS, records_of, tune_all
    from estimation.alignment.scenarios import EXPERIMENT

    shown = tuple(method for method in methods if method in AS_PRINTED) or methods
    records = records_of(EXPERIMENT, 1, seed)
    with terminal.progress("generations of the tuners, experiment", GENERATIONS) as progress:
        on_experiment = tune_all(records, shown, seed, progress)
    return [draw_figure_5(tuned, seed, folder), draw_figure_7(records, on_experiment, seed, folder)]


def _conditions(case: Alignment) -> str:
    return (
        f"{case.grade}, latitude {case.latitude_deg:g}°, height {case.height_m:g} m, {case.duration_s:g} s, prior "
        f"{case.level_deg:g}° and {case.heading_deg:g}°"
    )


def _print_settings(rows: list[dict[str, Any]], runs: int) -> None:
    from daemon import terminal

    made = terminal.table(
        f"{runs} virtual sensors each, at rest",
        "setting",
        "about",
        "angle",
        "rms deg",
        "bound deg",
        "rms / bound",
        "NEES/3",
        "verdict",
    )
    last = None
    for row in rows:
        if last not in (None, row["scenario"]):
            made.add_section()
        last = row["scenario"]
        made.add_row(
            row["scenario"],
            row["about"],
            row["axis"],
            f"{row['rms_deg']:.5f}",
            f"{row['bound_deg']:.5f}",
            f"{row['rms_deg'] / row['bound_deg']:.2f}",
            f"{row['nees']:.2f}",
            row["verdict"],
        )
    terminal.OUT.print(made)


def _print_tuned(rows: list[dict[str, Any]]) -> None:
    from daemon import terminal
    from daemon.offline.alignment.tuning import SIMULATION

    made = terminal.table(
        f"Process noise by tuners, paper B's Tables 2 and 3 (AL-8: {_conditions(SIMULATION)}), {rows[0]['runs']} runs, "
        "2,000 alignments a search",
        "method",
        "angle",
        "rms deg",
        "on another record",
        "claimed ± 1σ deg",
        "rms rad",
        "printed (read as rad)",
        "Q, median",
        "least to most",
    )
    last = None
    for row in rows:
        if last not in (None, row["method"]):
            made.add_section()
        last = row["method"]
        made.add_row(
            row["method"],
            row["axis"],
            f"{row['rms_deg']:.5f}",
            f"{row['rms_elsewhere_deg']:.5f}",
            f"{row['sigma_deg']:.5f}",
            f"{row['rms_rad']:.2e}",
            "" if row["printed_rad"] is None else f"{row['printed_rad']:.2e}",
            "–" if row["q"] is None else f"{row['q']:.1e}",
            "–" if row["q"] is None else f"{row['q_least']:.0e} to {row['q_most']:.0e}",
        )
    terminal.OUT.print(made)


def _print_experiment(rows: list[dict[str, Any]]) -> None:
    from daemon import terminal
    from estimation.alignment.scenarios import EXPERIMENT

    made = terminal.table(
        f"Paper B's experiment, Table 4 ({_conditions(EXPERIMENT)}), process noise ours, {rows[0]['runs']} runs",
        "angle",
        "rms deg",
        "claimed ± 1σ deg",
        "limit deg",
        "limit of the ADIS16448, its truth",
        "printed error deg",
        "verdict",
    )
    for row in rows:
        ends = (row["limit_deg"], row["limit_of_reference_deg"])
        made.add_row(
            row["axis"],
            f"{row['rms_deg']:.3f}",
            f"{row['sigma_deg']:.3f}",
            *(f"{end:.3f}" if end < align_tables.NO_LIMIT_DEG else "none" for end in ends),
            f"{row['printed_error_deg']:.4f}",
            row["verdict"],
        )
    terminal.OUT.print(made)
