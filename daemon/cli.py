"""The command line: `ramstroke COMMAND`.

Exit codes: 0 good, 1 the thing failed, 2 wrong usage or configuration, 130 interrupted.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import textwrap
from collections.abc import Sequence
from types import ModuleType

from daemon.interrupt import interruptible

INTERRUPTED = 130

# Command -> module in daemon.commands. Only the module of the command in use is imported.
COMMANDS = {
    "demo": "demo",
    "run": "run",
    "sim": "sim",
    "check-config": "check_config",
    "install-service": "install_service",
    "remove-service": "remove_service",
    "doctor": "doctor",
    "status": "status",
    "view": "view",
    "watch": "watch",
    "import": "import_csv",
    "replay": "replay",
    "review": "review",
    "recover": "recover",
    "evaluate": "evaluate",
    "tune": "tune",
    "align": "align",
}
SUMMARY = {
    "demo": "measure one cycle of a virtual support, nothing learned before",
    "run": "the daemon: read the sensors, estimate, record",
    "sim": "a virtual support for another process: sensor on a socket, controller on CAN",
    "check-config": "check a configuration file",
    "install-service": "make this installation the service of this computer",
    "remove-service": "take the service away; recordings stay",
    "doctor": "what is wrong with wires, sensors, CAN, disk, rights, service, and what to do",
    "status": "what the running daemon sees",
    "view": "the live page: what the daemon sees, for browsers",
    "watch": "the running daemon live at the terminal",
    "import": "make a recording from a CSV table",
    "replay": "run a recording through the estimator again",
    "review": "sum up a recording",
    "recover": "make a cut or damaged recording whole",
    "evaluate": "accuracy on many virtual supports",
    "tune": "find Q and R of a Kalman filter for recorded moves; compare tuners",
    "align": "level and heading of the sensor from a rest",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    with interruptible(is_program=arguments is None) as interrupt:
        try:
            return _main(list(sys.argv[1:] if arguments is None else arguments))
        except BaseException as error:
            # Some libraries turn an interrupt into an error of their own.
            if isinstance(error, KeyboardInterrupt) or (isinstance(error, Exception) and interrupt.has_come):
                print("interrupted", file=sys.stderr)
                return INTERRUPTED
            raise


def _main(arguments: list[str]) -> int:
    try:
        from daemon.errors import describe

        code = _run(arguments)
        sys.stdout.flush()  # at the interpreter's end a broken pipe could no longer be caught
        return code
    except BrokenPipeError:
        # The reader of our output has gone, as with `| head`; nobody is left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        described = describe(error)
        if described is None:
            raise
        code, sentences = described
        for sentence in sentences:
            print(f"ramstroke: {sentence}", file=sys.stderr)
        return code


def _run(arguments: list[str]) -> int:
    module = _load(arguments[0]) if arguments and arguments[0] in COMMANDS else None
    parser = _parser(arguments[0] if module else None, module)
    try:
        parsed = parser.parse_args(arguments)
    except SystemExit as end:
        return int(end.code or 0)
    if module is None:
        parser.print_help()
        return 2
    return int(module.run(parsed))


def _load(command: str) -> ModuleType:
    return importlib.import_module(f"daemon.commands.{COMMANDS[command]}")


def _parser(chosen: str | None, module: ModuleType | None) -> argparse.ArgumentParser:
    from daemon.recording.metadata import program_version

    parser = argparse.ArgumentParser(
        prog="ramstroke",
        description="How far has the roof support pushed the conveyor? From an inertial sensor and CAN.",
        epilog="Exit codes: 0 good, 1 the thing failed, 2 wrong usage or configuration. "
        "`ramstroke COMMAND --help` shows options and an example.",
    )
    parser.add_argument("--version", action="version", version=f"ramstroke {program_version()}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, dest="command")
    for name, summary in SUMMARY.items():
        if name == chosen and module is not None:
            sub = commands.add_parser(
                name,
                help=summary,
                description=textwrap.fill(module.HELP, 100),
                epilog=f"Example:\n  {module.EXAMPLE}",
                formatter_class=argparse.RawDescriptionHelpFormatter,
            )
            module.configure(sub)
        else:
            commands.add_parser(name, help=summary)
    return parser


if __name__ == "__main__":
    sys.exit(main())
