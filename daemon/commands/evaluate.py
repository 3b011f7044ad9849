"""`ramstroke evaluate`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from daemon.commands import choices, methods

HELP = (
    "Accuracy on many virtual supports, truth known: with and without the displacement sensor, beside the clock "
    "(nominal speed x true duration) on the same seeds."
)
# Beside a figure that lies outside the 99 % interval of a consistent filter.
MARK = "*"
INTERVALS = {"coverage_95": "coverage_99", "nees": "nees_99"}  # by figure: where a consistent filter's lies
EXAMPLE = "ramstroke evaluate --scenario partial --seeds 1:31 --warm 4 --jobs 2"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        "--scenario",
        default="nominal",
        metavar="NAME,...",
        help="of the library, separated by commas; `all`, or `list` to see them",
    )
    parser.add_argument(
        "--seeds", type=choices.seeds, default=range(1, 11), metavar="A:B", help="from A to before B (default 1:11)"
    )
    parser.add_argument(
        "--warm", type=int, default=0, metavar="K", help="full cycles before the judged one, to learn from (default 0)"
    )
    parser.add_argument(
        "--no-can", action="store_true", help="only without the displacement sensor; a warm-up has it all the same"
    )
    methods.configure(parser, several=True)
    parser.add_argument("--jobs", type=int, default=1, help="processes to use (default 1)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="a picture for each scenario, into this folder")


def run(arguments: argparse.Namespace) -> int:
    """Evaluate; failures of the estimator are figures, not failures of the command."""
    from dataclasses import asdict

    from daemon import terminal
    from daemon.errors import UsageError
    from daemon.offline.evaluation.runs import evaluate
    from daemon.offline.evaluation.scenarios import SCENARIOS_OF_EVALUATION
    from daemon.offline.evaluation.score import Case

    if arguments.scenario == "list":
        made = terminal.table("Scenarios", "name", "what")
        for name, scenario in SCENARIOS_OF_EVALUATION.items():
            made.add_row(name, scenario.about)
        terminal.OUT.print(made)
        return 0
    if arguments.method == "list":
        return methods.show()
    named = SCENARIOS_OF_EVALUATION if arguments.scenario == "all" else arguments.scenario.split(",")
    names = list(dict.fromkeys(choices.known("--scenario", name.strip(), SCENARIOS_OF_EVALUATION) for name in named))
    _check(arguments)
    if arguments.method != methods.OURS:
        return _compare(names, arguments)
    cases = [
        Case(name, seed, mode, arguments.warm)
        for name in names
        for mode in SCENARIOS_OF_EVALUATION[name].modes
        for seed in arguments.seeds
        if mode == "inertial" or not arguments.no_can
    ]
    if not cases:
        raise UsageError("--no-can leaves nothing: these scenarios are about the displacement sensor")
    names = list(dict.fromkeys(case.scenario for case in cases))
    with terminal.progress("virtual supports", len(cases)) as progress:
        results = evaluate(cases, arguments.jobs, progress)
    failures = [result for result in results if result.failure]
    rows = {name: _rows([result for result in results if result.case.scenario == name], name) for name in names}
    if arguments.plot is not None:
        from daemon.offline.evaluation.plots import plot_evaluation

        for name in names:
            plot_evaluation([result for result in results if result.case.scenario == name], arguments.plot)
    if arguments.json:
        terminal.print_json(
            {
                "seeds": [arguments.seeds.start, arguments.seeds.stop],
                "warm_up": arguments.warm,
                "scenarios": rows,
                "failures": [asdict(result.case) | {"failure": result.failure} for result in failures],
                "records": [asdict(result) for result in results],
            }
        )
        return 0
    _print(rows, arguments)
    _print_delays(rows)
    for result in failures:
        case = result.case
        terminal.OUT.print(f"{case.scenario}, seed {case.seed}, {case.mode}: {result.failure}", highlight=False)
    return 0


def _compare(scenarios: list[str], arguments: argparse.Namespace) -> int:
    """All methods asked for, side by side."""
    from dataclasses import asdict

    from daemon import terminal
    from daemon.errors import UsageError
    from daemon.offline.evaluation.methods import evaluate_methods, summarise_methods
    from estimation.methods.registry import METHODS

    if arguments.warm or arguments.no_can:
        raise UsageError(f"--warm and --no-can are for --method {methods.OURS}: the others learn nothing")
    named = METHODS if arguments.method == "all" else arguments.method.split(",")
    names = list(dict.fromkeys(methods.known(name.strip()) for name in named))
    with terminal.progress("virtual supports", len(scenarios) * len(arguments.seeds)) as progress:
        results = evaluate_methods(names, scenarios, arguments.seeds, arguments.jobs, progress)
    rows = summarise_methods(results)
    if arguments.plot is not None:
        from daemon.offline.evaluation.paper_figures import draw_figures
        from daemon.offline.tuning.plots import draw_paper_a

        for scenario in scenarios:
            draw_figures(scenario, arguments.seeds[0], arguments.plot)
        draw_paper_a(arguments.plot)  # figures 7 and 8: an artificial signal, whatever the scenario
    if arguments.json:
        seeds = [arguments.seeds.start, arguments.seeds.stop]
        terminal.print_json({"seeds": seeds, "rows": rows, "records": [asdict(result) for result in results]})
        return 0
    _print_methods(rows, arguments)
    return 0


def _print_methods(rows: list[dict[str, Any]], arguments: argparse.Namespace) -> None:
    from daemon import terminal

    made = terminal.table(
        f"Seeds {arguments.seeds.start}:{arguments.seeds.stop}, first cycle, before any stop is believed",
        "scenario",
        "move",
        "method",
        "median mm",
        "p95",
        "worst",
        "CVS speed off mm/s",
        "≤ 2 mm/s",
        "MSE of v, VVS (mm/s)²",
        "CVS",
        "wrong moves",
    )
    for row in rows:
        told = "median_mm" in row
        made.add_row(
            row["scenario"],
            row["move"],
            row["method"],
            *(_short(row[f"{key}_mm"]) if told else "–" for key in ("median", "p95", "worst")),
            f"{_short(row['cvs_speed_median_mm_s'])} | {_short(row['cvs_speed_p95_mm_s'])}" if told else "–",
            f"{row['cvs_speed_within_2_mm_s']:.0%}" if told else "–",
            *(_short(row[f"{segment}_mse_median_mm2_s2"]) if told else "–" for segment in ("vvs", "cvs")),
            f"{row['failures']} of {row['records']}",
        )
    terminal.OUT.print(made)


def _short(value: float) -> str:
    """Three digits or so."""
    return f"{value:.2f}" if value < 10 else f"{value:.1f}" if value < 100 else f"{value:.0f}"


def _check(arguments: argparse.Namespace) -> None:
    from daemon.errors import UsageError

    if arguments.jobs < 1:
        raise UsageError("--jobs must be at least 1")
    if not 0 <= arguments.warm <= 100:
        raise UsageError("--warm must lie between 0 and 100 cycles")
    if arguments.plot is not None:
        choices.picture_folder("--plot", arguments.plot)


def _rows(results: list[Any], scenario: str) -> dict[str, dict[str, Any]]:
    """Of one scenario: for each judged move a row per mode and the clock's."""
    from daemon.offline.evaluation.summary import row_names, summarise, summarise_clock, summarise_rest

    modes = list(dict.fromkeys(result.case.mode for result in results))
    rows: dict[str, dict[str, Any]] = {}
    if any(result.rest_s for result in results):
        for mode in modes:
            rows[f"{mode} rest"] = summarise_rest([result for result in results if result.case.mode == mode])
    for index, name in enumerate(row_names(scenario)):
        for mode in modes:
            rows[f"{mode} {name}"] = summarise([result for result in results if result.case.mode == mode], index)
        rows[f"clock {name}"] = summarise_clock([result for result in results if result.case.mode == modes[0]], index)
    return rows


def _print(rows: dict[str, dict[str, dict[str, Any]]], arguments: argparse.Namespace) -> None:
    from daemon import terminal

    seeds = arguments.seeds
    after = f" after {arguments.warm} cycles" if arguments.warm else ""
    made = terminal.table(
        f"Seeds {seeds.start}:{seeds.stop}{after}: error at a move's end, before any stop constraint",
        "scenario",
        "what",
        "median mm",
        "p95",
        "worst",
        "rms",
        "RMSE in move",
        "smoothed",
        "95 % holds",
        "NEES",
        "NIS",
        "onset ms",
        "stop ms",
        "failed",
    )
    rests = []
    for scenario, of_scenario in rows.items():
        for name, row in of_scenario.items():
            if "hours" in row:
                low, high = row["false_per_hour_95"]
                rests.append(
                    f"{scenario}, {name}: {row['false_moves']} false moves in {row['hours']:.2f} h, "
                    f"{row['false_per_hour']:.2f} an hour (95 %: {low:.2f} to {high:.2f})"
                )
                continue
            made.add_row(
                scenario,
                name,
                *(_figure(row, f"{key}_mm", 1) for key in ("median", "p95", "worst", "rms")),
                *(_figure(row, key, 1) for key in ("rmse_median_mm", "smoothed_rmse_median_mm")),
                *(_figure(row, key, 2) for key in ("coverage_95", "nees", "nis")),
                *(f"{_figure(row, f'{e}_median_ms', 0)} | {_figure(row, f'{e}_p95_ms', 0)}" for e in ("onset", "stop")),
                f"{row['failures']} of {row['records']}",
            )
    terminal.OUT.print(made)
    for line in rests:
        terminal.OUT.print(line, highlight=False)


def _print_delays(rows: dict[str, dict[str, dict[str, Any]]]) -> None:
    from daemon import terminal

    made = terminal.table(
        "Delays (median | p95), speed, and either tier at a random instant",
        "scenario",
        "what",
        "proposed s",
        "confirmed s",
        "told s",
        "CVS speed mm/s",
        "mean speed mm/s",
        "prov. 95 %",
        "NEES",
        "settled 95 %",
        "NEES",
        "rms of clock's",
    )
    marked = False
    for scenario, of_scenario in rows.items():
        for name, row in of_scenario.items():
            if "rms_of_clock" not in row:
                continue
            honest = [_marked(row, f"{tier}_{what}", what) for tier in ("provisional", "settled") for what in INTERVALS]
            marked |= any(cell.endswith(MARK) for cell in honest)
            low, high = row["rms_of_clock_95"]
            made.add_row(
                scenario,
                name,
                *(_both(row, key, "s", 2) for key in ("proposed", "confirmed", "told")),
                *(_both(row, key, "mm_s", 2) for key in ("cvs_speed", "mean_speed")),
                *honest,
                f"{row['rms_of_clock']:.2f} ({low:.2f}–{high:.2f})",
            )
    if made.row_count:
        terminal.OUT.print(made)
    if marked:
        terminal.OUT.print(f"{MARK} outside what 99 of 100 consistent filters show", highlight=False)


def _marked(row: dict[str, Any], key: str, what: str) -> str:
    low, high = row[INTERVALS[what]]
    return f"{row[key]:.2f}{'' if low <= row[key] <= high else MARK}"


def _both(row: dict[str, Any], key: str, unit: str, digits: int) -> str:
    return f"{_figure(row, f'{key}_median_{unit}', digits)} | {_figure(row, f'{key}_p95_{unit}', digits)}"


def _figure(row: dict[str, Any], key: str, digits: int) -> str:
    return f"{row[key]:.{digits}f}" if key in row else "–"
