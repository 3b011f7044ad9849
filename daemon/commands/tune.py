"""`ramstroke tune`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daemon.commands import choices, tune_benchmark

if TYPE_CHECKING:
    from daemon.settings import Settings

HELP = (
    "Find the noises Q and R of a Kalman filter for recorded moves: of paper A's two-state filter (target kf2), or the "
    "process noises of our own (target mskf). The objective ml, the likelihood of the innovations, needs no truth; "
    "truth is the error against a reference sensor in the recording. --benchmark compares all tuners on problems "
    "whose answer is known."
)
EXAMPLE = "ramstroke tune shift1.mcap shift2.mcap --save tuned.toml --plot pictures"
OBJECTIVES = ("ml", "truth")
TARGETS = ("kf2", "mskf")
FORMS = ("BqB", "qI")
LEAST_WHITE = 0.01


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("files", type=Path, nargs="*", help="recordings; all their moves are tuned on together")
    parser.add_argument(
        "--method", default="auto", metavar="NAME", help="how to search (default auto); `list` shows all"
    )
    parser.add_argument("--objective", choices=OBJECTIVES, default="ml", help="what is best (default ml)")
    parser.add_argument("--target", choices=TARGETS, default="kf2", help="whose noises (default kf2)")
    parser.add_argument(
        "--form", choices=FORMS, default="BqB", help="how Q enters the covariance of kf2: q B Bᵀ (default) or q I"
    )
    parser.add_argument("--config", type=Path, help="settings to use instead of those in the recordings")
    parser.add_argument("--seed", type=int, default=0, help="of the methods that draw random numbers (default 0)")
    parser.add_argument(
        "--budget", type=int, help="evaluations at most (default 2020; of mskf, where one is a run, 40)"
    )
    parser.add_argument(
        "--save", type=Path, metavar="CONFIG.toml", help="write the result into this configuration file"
    )
    parser.add_argument("--benchmark", choices=("artificial", "functions"), help="compare all tuners instead")
    parser.add_argument(
        "--seeds", type=choices.seeds, default=range(0, 5), metavar="A:B", help="of the benchmark (default 0:5)"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes to use (default 1)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--plot", type=Path, metavar="DIR", help="pictures, into this folder")


def run(arguments: argparse.Namespace) -> int:
    """Tune, or compare tuners."""
    from daemon.configuration import load
    from daemon.errors import CommandError, UsageError
    from estimation.tuning.optimisers import OPTIMISERS

    if arguments.method == "list":
        return _show()
    if arguments.jobs < 1:
        raise UsageError("--jobs must be at least 1")
    if arguments.budget is not None and arguments.budget < 1:
        raise UsageError("--budget must be at least 1 evaluation")
    if arguments.seed < 0:
        raise UsageError("--seed must not be negative")
    choices.known("--method", arguments.method, OPTIMISERS)
    if arguments.plot is not None:
        choices.picture_folder("--plot", arguments.plot)
    if arguments.benchmark:
        if arguments.files or arguments.save:
            raise UsageError("--benchmark makes its own data: name no recording and no --save beside it")
        return tune_benchmark.run(arguments)
    if not arguments.files:
        raise UsageError("name the recordings to tune on, or --benchmark artificial | functions")
    if len(set(arguments.files)) < len(arguments.files):
        raise UsageError("a recording is named twice; once is enough")
    settings = None if arguments.config is None else load(arguments.config)
    try:
        return (_two_state if arguments.target == "kf2" else _estimator)(arguments, settings)
    except ValueError as error:
        if type(error) is not ValueError:  # pydantic's and others that have sentences of their own
            raise
        raise CommandError(f"{', '.join(map(str, arguments.files))}: {error}") from error


def _show() -> int:
    from daemon import terminal
    from estimation.tuning.optimisers import OPTIMISERS

    made = terminal.table("Methods", "name", "what")
    for name, optimiser in OPTIMISERS.items():
        made.add_row(name, optimiser.about)
    terminal.OUT.print(made)
    return 0


def _two_state(arguments: argparse.Namespace, settings: Settings | None) -> int:
    from dataclasses import asdict

    from daemon import terminal
    from daemon.offline.tuning.recordings import motions_of, row_of, tuned_on_others
    from estimation.tuning.optimisers import BUDGET
    from estimation.tuning.two_state_tuning import tune

    budget = arguments.budget or BUDGET
    motions = []
    with terminal.progress("reading recordings", len(arguments.files)) as progress:
        for done, path in enumerate(arguments.files):
            motions += motions_of(path, arguments.form, settings, _on_from(done, progress))
    observed = [motion.observed for motion in motions]
    tuned = tune(observed, arguments.form, arguments.method, arguments.objective, arguments.seed, budget)
    others = tuned_on_others(motions, arguments.form, arguments.method, arguments.objective, arguments.seed, budget)
    if arguments.plot is not None:
        from daemon.offline.tuning.plots import draw_tuning

        drawn = draw_tuning(observed, tuned, arguments.plot)
    row = row_of(tuned)
    if arguments.save is not None:
        if tuned.better_log10_ratio is not None or not tuned.determined:
            terminal.ERR.print("Saved all the same: what is said below about q/r holds for the file.")
        _save(arguments, settings, {"two_state": {"q": tuned.q, "r": tuned.r, "form": tuned.form}}, row)
    if arguments.json:
        terminal.print_json(
            {
                "files": [str(path) for path in arguments.files],
                "target": "kf2",
                "moves": [{"file": motion.file, "move": motion.number} for motion in motions],
                "result": row | {"history": tuned.history},
                "rms_error_on_other_moves_mm": None if others is None else asdict(others)["by"],
            }
        )
        return 0
    _print_two_state(row, len(motions))
    if others is not None:
        made = terminal.table("Error on moves that were not tuned on, against the reference sensor", "Q, R", "rms mm")
        for name, value in others.by.items():
            made.add_row(name, f"{value:.2f}")
        terminal.OUT.print(made)
    if arguments.plot is not None:
        for path in drawn:
            terminal.say(f"Picture: {path}")
    return 0


def _on_from(done: int, progress: Callable[[float], None]) -> Callable[[float], None]:
    return lambda share: progress(done + share)


def _print_two_state(row: dict[str, Any], moves: int) -> None:
    from math import isfinite

    from daemon import terminal

    made = terminal.table(
        f"Q and R of the two-state filter, {moves} {'move' if moves == 1 else 'moves'}", "what", "value"
    )
    unit = "(m/s²)²" if row["form"] == "BqB" else "m², (m/s)² per sample"
    made.add_row(f"q, {unit}", f"{row['q']:.4g}")
    made.add_row("r, m²", f"{row['r']:.4g} (a reading is off by {row['r'] ** 0.5 * 1e3:.2f} mm)")
    made.add_row("log10(q/r)", f"{row['log10_ratio']:.3f}")
    if row["objective"] == "ml":
        ends = [row[f"log10_ratio_{end}"] for end in ("low", "high")]
        made.add_row(
            "3 sigma of the optimum", " to ".join(f"{end:.2f}" if isfinite(end) else "beyond the range" for end in ends)
        )
    made.add_row("evaluations", str(row["evaluations"]))
    made.add_row("innovations white (Ljung-Box p)", f"{row['whiteness_p']:.3g}")
    made.add_row("NIS, share within its 95 %", f"{row['nis']:.2f}, {row['nis_inside_95']:.3f}")
    terminal.OUT.print(made)
    if row["better_log10_ratio"] is not None:
        terminal.say(
            f"The method {row['method']} missed the optimum: auto finds log10(q/r) = {row['better_log10_ratio']:.3f}."
        )
    if not row["determined"]:
        terminal.say(
            "Not determined: these moves do not tell q/r within two decades; record more of them, or set Q and R "
            "from the data sheets."
            if row["objective"] == "ml"
            else "Not determined: the least error lies at the end of the range searched; the filter then follows one "
            "sensor alone."
        )
    if row["whiteness_p"] < LEAST_WHITE:
        terminal.say(
            "The innovations are not white: something other than noise is in the readings, such as a scale error, "
            "which no Q and R of this filter remove."
        )


def _estimator(arguments: argparse.Namespace, settings: Settings | None) -> int:
    from daemon import terminal
    from daemon.errors import UsageError
    from daemon.offline.tuning.estimator import BUDGET, tune_estimator

    if arguments.method != "auto":
        raise UsageError("--method is for the target kf2; of mskf, where each evaluation is a run, only auto is known")
    budget = arguments.budget or BUDGET
    with terminal.progress("runs over the recordings", 3 * budget) as progress:
        tuned = tune_estimator(arguments.files, settings, arguments.objective, budget, arguments.jobs, progress)
    row: dict[str, Any] = {
        "method": "nelder_mead",
        "objective": tuned.goal,
        **tuned.values,
        "before": tuned.before,
        "value": tuned.found.value,
        "evaluations": tuned.found.evaluations,
        "on_other_moves_before": tuned.judged_before,
        "on_other_moves_after": tuned.judged_after,
        "better": tuned.judged_after < tuned.judged_before,
    }
    if arguments.save is not None:
        if not row["better"]:
            terminal.ERR.print("On moves not tuned on the new values are no better; they are saved all the same.")
        _save(arguments, settings, {"estimator": tuned.values}, row)
    drawn: list[Path] = []
    if arguments.plot is not None:
        from daemon.offline.tuning.plots import draw_search

        drawn = draw_search(tuned.found, arguments.plot)
    if arguments.json:
        row["history"] = tuned.found.history
        files = [str(path) for path in arguments.files]
        terminal.print_json({"files": files, "target": "mskf", "moves": tuned.moves, "result": row})
        return 0
    made = terminal.table(f"Process noises of our estimator, {tuned.moves} moves", "setting", "before", "tuned")
    for name, value in tuned.values.items():
        made.add_row(f"estimator.{name}", f"{tuned.before[name]:.4g}", f"{value:.4g}")
    unit = "deviance a reading" if tuned.goal == "ml" else "mean squared error, mm²"
    made.add_row(f"on moves not tuned on: {unit}", f"{tuned.judged_before:.4f}", f"{tuned.judged_after:.4f}")
    terminal.OUT.print(made)
    if tuned.values == tuned.before:
        terminal.say(f"Nothing better was found in {tuned.found.evaluations} runs.")
    elif not row["better"]:
        terminal.say("On moves that were not tuned on the new values are no better: keep the old ones.")
    for path in drawn:
        terminal.say(f"Picture: {path}")
    return 0


def _save(
    arguments: argparse.Namespace, settings: Settings | None, values: dict[str, dict[str, Any]], row: dict[str, Any]
) -> None:
    from daemon import terminal
    from daemon.offline.replaying.replay import settings_of
    from daemon.offline.tuning.saving import save
    from daemon.recording.reader import Recording

    in_use = settings or settings_of(Recording(arguments.files[0]))
    save(arguments.save, values, in_use, arguments.files, row | {"seed": arguments.seed})
    if not arguments.json:
        terminal.say(f"Written: {arguments.save}")
