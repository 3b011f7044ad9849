"""`ramstroke replay`."""

from __future__ import annotations

import argparse
from pathlib import Path

from daemon.commands import methods

HELP = (
    "Run what a recording received through the estimator again, as fast as possible. Without --config the file's "
    "own settings hold, and the estimates it holds are compared bit for bit with the new ones."
)
EXAMPLE = "ramstroke replay shift.mcap --csv shift.csv --json"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("file", type=Path, nargs="?", help="the recording")
    methods.configure(parser)
    parser.add_argument("--config", type=Path, help="settings to use instead of the file's own")
    parser.add_argument(
        "--state", type=Path, help="start from this state file; the recorded estimates are then not compared"
    )
    parser.add_argument("--save-state", type=Path, help="write the state at the end to this file")
    parser.add_argument("-o", "--output", type=Path, help="write inputs and new estimates to this recording")
    parser.add_argument("--csv", type=Path, help="write one row per step to this table")
    parser.add_argument("--provisional", action="store_true", help="in the table: provisional values, not settled ones")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Replay."""
    from daemon import terminal
    from daemon.configuration import load
    from daemon.offline.replaying.outputs import replay_to
    from daemon.rows import learned_row, learned_words

    if arguments.method == "list":
        return methods.show()
    _check(arguments)
    settings = load(arguments.config) if arguments.config else None
    with terminal.progress(f"replaying {arguments.file.name}") as progress:
        result = replay_to(
            arguments.file,
            settings,
            output=arguments.output,
            table=arguments.csv,
            provisional=arguments.provisional,
            state=arguments.state,
            end_state=arguments.save_state,
            method=arguments.method,
            progress=progress,
        )
    learned = learned_row(result.learned)
    for sentence in result.damage:
        terminal.ERR.print(f"{arguments.file}: {sentence}", highlight=False, markup=False)
    if arguments.json:
        terminal.print_json(
            {
                "method": arguments.method,
                "samples": result.samples,
                "bad_bursts": result.bad_bursts,
                "duration_s": result.duration_s,
                "realtime_factor": result.realtime_factor,
                "identical": result.identical,
                "moves": [terminal.move_row(move) for move in result.moves],
                "learned": learned,
                "damage": result.damage,
            }
        )
        return 0
    same = {True: "reproduced bit for bit", False: "NOT reproduced", None: "none recorded"}[result.identical]
    if arguments.state is not None or arguments.method != methods.OURS:
        same = "not compared"
    terminal.say(
        f"{result.samples} samples, {result.duration_s:.1f} s, {result.realtime_factor:.0f} × real time; "
        f"recorded estimates: {same}"
    )
    terminal.print_moves(result.moves)
    if arguments.method == methods.OURS:
        terminal.say(f"learned: {learned_words(learned)}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    from daemon.errors import UsageError

    if arguments.file is None:
        raise UsageError("name the recording to replay")
    if methods.known(arguments.method) == methods.OURS:
        return
    for option, given in (
        ("--state", arguments.state),
        ("--save-state", arguments.save_state),
        ("--provisional", arguments.provisional),
    ):
        if given:
            raise UsageError(f"{option} is for --method {methods.OURS}: {arguments.method} knows no such thing")
