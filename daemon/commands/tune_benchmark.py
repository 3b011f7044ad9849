"""`ramstroke tune --benchmark`: all tuners on problems whose answer is known."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daemon.offline.tuning.benchmark import Row

NOTES = {
    "artificial": (
        "Paper A prints the bare error, 0.39747 (PSO) to 0.020527 (IFOA), without dt, length or noise. With fixed data "
        "a working PSO and GA reach the optimum, so its first two rows cannot occur; what fits all five is a noise "
        "scaled by the candidate Q and R. AS-1 is its set-up as near as it can be read: all tuners solve it. "
        "The others tell them apart: paper A's flies cannot set the scale of S = 1/Dist."
    ),
    "functions": (
        "Paper B's flies find optima at the origin, because S = 1/Dist runs to 0 there; moved optima they miss. "
        "Zettl's printed 3.07e-11 is its value at S = 0, above its optimum -0.003791, which no positive S reaches."
    ),
}


def run(arguments: argparse.Namespace) -> int:
    """Compare all of them, or the one that is named."""
    from daemon import terminal
    from daemon.errors import UsageError
    from daemon.offline.tuning.benchmark import ON_ARTIFICIAL, ON_FUNCTIONS, benchmark, count, summarise
    from estimation.tuning.optimisers import OPTIMISERS

    kind = arguments.benchmark
    if arguments.budget is not None or arguments.target != "kf2" or arguments.objective != "ml":
        raise UsageError("--benchmark has a budget, target and objective of its own: leave these options out")
    if kind == "functions" and (OPTIMISERS[arguments.method].log10 or arguments.method == "grid"):
        raise UsageError(f"--method {arguments.method} is for Q and R: the functions have arguments of either sign")
    usual = ON_ARTIFICIAL if kind == "artificial" else ON_FUNCTIONS
    methods = usual if arguments.method == "auto" else (arguments.method,)
    with terminal.progress("runs", count(kind, arguments.seeds, methods)) as progress:
        rows = benchmark(kind, arguments.seeds, methods, arguments.jobs, progress)
    summary = summarise(rows)
    drawn = [] if arguments.plot is None else _draw(kind, rows, arguments)
    if arguments.json:
        terminal.print_json({"benchmark": kind, "rows": [row.told(kind) for row in rows], "summary": summary})
        return 0
    _print(kind, summary, arguments.seeds)
    for path in drawn:
        terminal.say(f"Picture: {path}")
    return 0


def _draw(kind: str, rows: list[Row], arguments: argparse.Namespace) -> list[Any]:
    from daemon.offline.tuning import plots as tuning_plots

    if kind == "functions":
        return tuning_plots.draw_functions(rows, arguments.plot)
    return [*tuning_plots.draw_artificial(rows, arguments.plot), *tuning_plots.draw_paper_a(arguments.plot)]


def _print(kind: str, summary: list[dict[str, Any]], seeds: range) -> None:
    from daemon import terminal

    relative = kind == "artificial"
    made = terminal.table(
        f"Seeds {seeds.start}:{seeds.stop}, excess over the true optimum" + (", relative" if relative else ""),
        "scenario" if relative else "function",
        "form of Q" if relative else "variant",
        "method",
        "median",
        "p95",
        "solved to 1e-6",
        "evaluations",
        "ms",
        "value, median",
        "printed",
    )
    last = None
    for row in summary:
        place = (row["problem"], row["variant"])
        if last not in (None, place):
            made.add_section()
        last = place
        made.add_row(
            *place,
            row["method"],
            f"{row['excess_median']:.1e}",
            f"{row['excess_p95']:.1e}",
            f"{row['solved']:.0%}",
            f"{row['evaluations_median']:.0f}",
            f"{row['seconds_median'] * 1e3:.0f}",
            f"{row['value_median']:.6g}",
            "" if row["printed"] is None else f"{row['printed']:.6g}",
        )
    terminal.OUT.print(made)
    terminal.say(NOTES[kind])
