"""`ramstroke evaluate`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

HELP = (
    "Accuracy on many virtual supports, truth known: with and without the displacement sensor, beside the clock "
    "(nominal speed x true duration) on the same seeds."
)
EXAMPLE = "ramstroke evaluate --scenario partial --seeds 1:31 --warm 4 --jobs 2"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        "--scenario", default="nominal", metavar="NAME", help="one of the library, `all`, or `list` to see them"
    )
    parser.add_argument(
        "--seeds", type=_seeds, default=range(1, 11), metavar="A:B", help="from A to before B (default 1:11)"
    )
    parser.add_argument(
        "--warm", type=int, default=0, metavar="K", help="full cycles before the judged one, to learn from (default 0)"
    )
    parser.add_argument(
        "--no-can", action="store_true", help="only without the displacement sensor; a warm-up has it all the same"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes to use (default 1)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="a picture for each scenario, into this folder")


def _seeds(text: str) -> range:
    first, _, last = text.partition(":")
    try:
        seeds = range(int(first), int(last))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form A:B, such as 1:31") from None
    if not seeds or seeds[0] < 0:
        raise argparse.ArgumentTypeError(f"{text!r} holds no seed: A must be smaller than B and not negative")
    return seeds


def run(arguments: argparse.Namespace) -> int:
    """Evaluate; failures of the estimator are figures, not failures of the command."""
    from dataclasses import asdict

    from daemon import terminal
    from daemon.offline.evaluation import MODES, Case, evaluate
    from daemon.offline.scenarios import SCENARIOS_OF_EVALUATION

    if arguments.scenario == "list":
        made = terminal.table("Scenarios", "name", "what")
        for name, scenario in SCENARIOS_OF_EVALUATION.items():
            made.add_row(name, scenario.about)
        terminal.OUT.print(made)
        return 0
    names = list(SCENARIOS_OF_EVALUATION) if arguments.scenario == "all" else [_known(arguments.scenario)]
    _check(arguments)
    modes = MODES[1:] if arguments.no_can else MODES
    cases = [Case(name, seed, mode, arguments.warm) for name in names for mode in modes for seed in arguments.seeds]
    with terminal.progress("virtual supports", len(cases)) as progress:
        results = evaluate(cases, arguments.jobs, progress)
    failures = [result for result in results if result.failure]
    rows = {name: _rows([result for result in results if result.case.scenario == name], name) for name in names}
    if arguments.plot is not None:
        from daemon.offline.evaluation_plots import plot_evaluation

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
    for result in failures:
        case = result.case
        terminal.OUT.print(f"{case.scenario}, seed {case.seed}, {case.mode}: {result.failure}", highlight=False)
    return 0


def _known(name: str) -> str:
    from difflib import get_close_matches

    from daemon.errors import UsageError
    from daemon.offline.scenarios import SCENARIOS_OF_EVALUATION

    if name in SCENARIOS_OF_EVALUATION:
        return name
    near = get_close_matches(name, SCENARIOS_OF_EVALUATION, n=1)
    hint = f"did you mean {near[0]}?" if near else "--scenario list shows what there is"
    raise UsageError(f"--scenario {name} is unknown; {hint}")


def _check(arguments: argparse.Namespace) -> None:
    from daemon.errors import UsageError

    if arguments.jobs < 1:
        raise UsageError("--jobs must be at least 1")
    if not 0 <= arguments.warm <= 100:
        raise UsageError("--warm must lie between 0 and 100 cycles")
    if arguments.plot is not None:
        try:
            arguments.plot.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"--plot {arguments.plot}: {error.strerror}; name a folder that can be written") from None


def _rows(results: list[Any], scenario: str) -> dict[str, dict[str, Any]]:
    """Of one scenario: for each judged move a row per mode and the clock's."""
    from daemon.offline.evaluation import row_names, summarise, summarise_clock

    modes = list(dict.fromkeys(result.case.mode for result in results))
    rows: dict[str, dict[str, Any]] = {}
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
        "onset ms",
        "stop ms",
        "failed",
    )
    for scenario, of_scenario in rows.items():
        for name, row in of_scenario.items():
            made.add_row(
                scenario,
                name,
                *(_figure(row, f"{key}_mm", 1) for key in ("median", "p95", "worst", "rms")),
                *(_figure(row, key, 1) for key in ("rmse_median_mm", "smoothed_rmse_median_mm")),
                *(_figure(row, key, 2) for key in ("coverage_95", "nees")),
                *(f"{_figure(row, f'{e}_median_ms', 0)} | {_figure(row, f'{e}_p95_ms', 0)}" for e in ("onset", "stop")),
                f"{row['failures']} of {row['records']}",
            )
    terminal.OUT.print(made)


def _figure(row: dict[str, Any], key: str, digits: int) -> str:
    return f"{row[key]:.{digits}f}" if key in row else "–"
