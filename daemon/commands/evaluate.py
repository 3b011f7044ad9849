"""`ramstroke evaluate`."""

from __future__ import annotations

import argparse
from typing import Any

HELP = (
    "Accuracy on many virtual supports: first cycle, nothing learned before, with and without the displacement "
    "sensor, beside the clock (nominal speed x true duration) on the same seeds."
)
EXAMPLE = "ramstroke evaluate --seeds 1:31 --jobs 2"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        "--scenario", default="nominal", help="distributions of the motion: nominal (default) or lab_bench"
    )
    parser.add_argument(
        "--seeds", type=_seeds, default=range(1, 11), metavar="A:B", help="from A to before B (default 1:11)"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes to use (default 1)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


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
    from daemon.errors import UsageError
    from daemon.offline.evaluation import MODES, evaluate, summarise, summarise_clock
    from drivers.virtual.scenarios import SCENARIOS

    if arguments.scenario not in SCENARIOS:
        raise UsageError(f"--scenario {arguments.scenario}: choose one of {', '.join(SCENARIOS)}")
    if arguments.jobs < 1:
        raise UsageError("--jobs must be at least 1")
    seeds = arguments.seeds
    with terminal.progress("virtual cycles", 2 * len(seeds)) as progress:
        results = evaluate(arguments.scenario, seeds, arguments.jobs, progress)
    rows: dict[str, dict[str, Any]] = {}
    for index, kind in enumerate(("push", "retract")):
        of_mode = {mode: [result for result in results if result.mode == mode] for mode in MODES}
        rows |= {f"{mode} {kind}": summarise(of_mode[mode], kind) for mode in MODES}
        rows[f"clock {kind}"] = summarise_clock(of_mode[MODES[0]], index)
    failures = [result for result in results if result.failure]
    if arguments.json:
        terminal.print_json(
            {
                "scenario": arguments.scenario,
                "seeds": [seeds.start, seeds.stop],
                "rows": rows,
                "failures": [
                    {"seed": result.seed, "mode": result.mode, "failure": result.failure} for result in failures
                ],
                "records": [asdict(result) for result in results],
            }
        )
        return 0
    made = terminal.table(
        f"{arguments.scenario}, seeds {seeds.start}:{seeds.stop}: error at a move's end, before any stop constraint",
        "what",
        "median mm",
        "p95",
        "worst",
        "RMSE in move",
        "smoothed",
        "95 % holds",
        "onset ms",
        "stop ms",
        "failed",
    )
    for name, row in rows.items():
        made.add_row(
            name,
            *(_figure(row, key, 1) for key in ("median_mm", "p95_mm", "worst_mm")),
            *(_figure(row, key, 1) for key in ("rmse_median_mm", "smoothed_rmse_median_mm")),
            _figure(row, "coverage_95", 2),
            *(f"{_figure(row, f'{e}_median_ms', 0)} | {_figure(row, f'{e}_p95_ms', 0)}" for e in ("onset", "stop")),
            f"{row['failures']} of {row['records']}",
        )
    terminal.OUT.print(made)
    for result in failures:
        terminal.OUT.print(f"seed {result.seed}, {result.mode}: {result.failure}", highlight=False)
    return 0


def _figure(row: dict[str, Any], key: str, digits: int) -> str:
    return f"{row[key]:.{digits}f}" if key in row else "–"
