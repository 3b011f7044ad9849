"""`ramstroke review`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daemon.commands import methods

if TYPE_CHECKING:
    from daemon.offline.alignment.allan import Allan
    from daemon.offline.reviewing.mount import MountReview
    from daemon.offline.reviewing.reference_errors import ReferenceErrors
    from daemon.offline.reviewing.review import Review
    from daemon.offline.reviewing.smoothed_moves import SmoothedMove

HELP = (
    "Sum up a recording: contents, gaps, faults, sensor health, moves, and the errors against the reference "
    "sensor if there is one. The moves are estimated anew from what was received, and smoothed: at each step "
    "with what came after it."
)
EXAMPLE = "ramstroke review /var/lib/ramstroke/recordings/ramstroke-20260105T063000Z.mcap --csv shift.csv"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("file", type=Path, nargs="?", help="the recording")
    methods.configure(parser)
    parser.add_argument("--csv", type=Path, help="write one row per step, settled and smoothed, to this table")
    parser.add_argument(
        "--estimate-mount", action="store_true", help="find out which way the sensor sits: what [mount] should say"
    )
    parser.add_argument(
        "--allan",
        action="store_true",
        help="noise of the sensor in the longest rest (Allan deviation), and the sensor grade that `align` takes",
    )
    parser.add_argument("--plot", type=Path, metavar="PICTURE", help="with --allan: the curves, into this file")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(arguments: argparse.Namespace) -> int:
    """Review."""
    from daemon import terminal
    from daemon.errors import UsageError
    from daemon.offline.alignment import allan_report
    from daemon.offline.alignment.allan import allan
    from daemon.offline.alignment.allan_plot import plot_allan
    from daemon.offline.reviewing.mount import review_mount
    from daemon.offline.reviewing.review import review
    from daemon.recording.errors import refuse_same_file

    if arguments.method == "list":
        return methods.show()
    if arguments.file is None:
        raise UsageError("name the recording to review")
    if arguments.plot is not None:
        if not arguments.allan:
            raise UsageError("--plot draws the Allan deviation: name --allan beside it")
        refuse_same_file(arguments.file, arguments.plot)
    method = methods.known(arguments.method)
    with terminal.progress("messages") as progress:
        reviewed = review(arguments.file, progress, arguments.csv, method)
        mount = review_mount(arguments.file, progress) if arguments.estimate_mount else None
        noise = allan(arguments.file, progress) if arguments.allan else None
    if noise is not None and arguments.plot is not None:
        plot_allan(arguments.plot, noise)
    result = reviewed.replayed
    if arguments.json:
        terminal.print_json(
            {
                "file": str(arguments.file),
                "method": method,
                "complete": reviewed.complete,
                "version": reviewed.metadata.get("version"),
                "sensor": reviewed.sensor,
                "kind": reviewed.metadata.get("kind"),
                "duration_s": result.duration_s,
                "samples": result.samples,
                "identical": result.identical,
                "messages": dict(reviewed.messages),
                "lost": reviewed.lost,
                "damage": result.damage,
                "faults": dict(reviewed.faults),
                "gaps": [asdict(gap) for gap in reviewed.gaps],
                "gaps_not_shown": reviewed.gaps_not_shown,
                "segments": _shares(reviewed.segments),
                "can_states": _shares(reviewed.can_states),
                "events": [{"t_s": event.t_ns * 1e-9, "what": event.what} for event in reviewed.events],
                "moves": [
                    terminal.move_row(move) | {"smoothed": _smoothed_row(reviewed.smoothed_moves.of(move))}
                    for move in result.moves
                ],
                "reference": _errors_row(reviewed.reference.settled()),
                "reference_smoothed": _errors_row(reviewed.reference.smoothed()),
                "mount": None if mount is None else mount.row(),
                "allan": None if noise is None else allan_report.row(noise),
                "health": reviewed.last_health,
            }
        )
        return 0
    _print(arguments.file, reviewed, mount)
    if arguments.plot is not None:
        terminal.say(f"Picture: {arguments.plot}")
    if noise is not None:
        _print_noise(noise)  # last: the grade at its end is for pasting
    return 0


def _shares(counts: Mapping[Any, int]) -> dict[str, float]:
    total = sum(counts.values())
    return {str(name): count / total for name, count in counts.items()}


def _smoothed_row(move: SmoothedMove | None) -> dict[str, float] | None:
    if move is None:
        return None
    first, last = move.first, move.last
    return {
        "start_mm": first.displacement_m * 1e3,
        "start_sigma_mm": first.sigma_m * 1e3,
        "end_mm": last.displacement_m * 1e3,
        "end_sigma_mm": last.sigma_m * 1e3,
        "velocity_mm_s": last.speed_m_s * 1e3,
        "velocity_sigma_mm_s": last.speed_sigma_m_s * 1e3,
        "largest_difference_mm": move.largest_difference_m * 1e3,
    }


def _errors_row(errors: ReferenceErrors | None) -> dict[str, Any] | None:
    return None if errors is None else asdict(errors)


def _print(path: Path, reviewed: Review, mount: MountReview | None) -> None:
    from daemon import terminal

    def say(text: str) -> None:
        terminal.OUT.print(text, highlight=False, markup=False)

    result, metadata = reviewed.replayed, reviewed.metadata
    state = "complete" if reviewed.complete else "cut short or still being written"
    say(f"{path}: {metadata.get('kind', 'recording')}, {state}, ramstroke {metadata.get('version', '?')}")
    if reviewed.sensor:
        say(f"sensor: {reviewed.sensor}")
    rate = result.samples / result.duration_s if result.duration_s else 0.0
    say(f"{result.duration_s:.1f} s, {result.samples} good samples ({rate:.1f}/s), {reviewed.lost} messages lost")
    same = {True: "reproduced bit for bit", False: "NOT reproduced", None: "none"}[result.identical]
    say(f"recorded estimates: {same}")
    for sentence in result.damage:
        say(f"damage: {sentence}")
    contents = terminal.table("Contents", "topic", "messages")
    for topic, count in reviewed.messages.items():
        contents.add_row(topic, str(count))
    terminal.OUT.print(contents)
    for kind, count in reviewed.faults.items():
        say(f"bad bursts: {count} × {kind}")
    for gap in reviewed.gaps:
        say(f"gap of {gap.length_s:.3f} s at {gap.at_s:.3f} s")
    if reviewed.gaps_not_shown:
        say(f"... and {reviewed.gaps_not_shown} gaps more")
    for title, counts in (
        ("time in segments", reviewed.segments),
        ("displacement sensor", reviewed.can_states),
    ):
        shares = _shares(counts)
        say(f"{title}: " + (", ".join(f"{name} {share:.1%}" for name, share in shares.items()) or "none"))
    for event in reviewed.events:
        say(f"{event.t_ns * 1e-9:12.3f} s  {event.what}")
    terminal.print_moves(result.moves)
    for move in result.moves:
        row = _smoothed_row(reviewed.smoothed_moves.of(move))
        if row is not None:
            say(f"{move.kind} at {move.onset_ns * 1e-9:.2f} s, smoothed: {_move_in_words(row)}")
    settled, smoothed = reviewed.reference.settled(), reviewed.reference.smoothed()
    if settled is None:
        say("no reference sensor in it")
    else:
        say(f"against the reference ({settled.readings} readings): {_errors_in_words(settled)}")
    if smoothed is not None:
        say(f"smoothed, against the same: {_errors_in_words(smoothed)}")
    for line in () if mount is None else mount.lines():
        say(line)


def _print_noise(noise: Allan) -> None:
    from daemon import terminal
    from daemon.offline.alignment.allan_report import ACCEL, GYRO, cells, grade_lines, remarks

    lost = f", {noise.missing} samples lost in it" if noise.missing else ""
    terminal.say(
        f"noise: Allan deviation of {noise.rest_s:.1f} s of rest from {noise.start_s:.1f} s on, "
        f"{noise.samples} samples ({1 / noise.period_s:.1f}/s){lost}"
    )
    for axes, units in ((noise.gyro, GYRO), (noise.accel, ACCEL)):
        made = terminal.table(
            units.title,
            "axis",
            f"white noise {units.walk}",
            "± 1σ",
            "between s",
            f"bias instability {units.rate}",
            "at s",
        )
        for axis in axes:
            made.add_row(*cells(axis, units))
        terminal.OUT.print(made)
    for line in (*remarks(noise), *grade_lines(noise)):
        terminal.say(line)


def _move_in_words(row: dict[str, float]) -> str:
    return (
        f"{row['start_mm']:.1f} ± {row['start_sigma_mm']:.1f} to {row['end_mm']:.1f} ± {row['end_sigma_mm']:.1f} mm "
        f"at {row['velocity_mm_s']:.2f} ± {row['velocity_sigma_mm_s']:.2f} mm/s, "
        f"{row['largest_difference_mm']:+.1f} mm from settled at most"
    )


def _errors_in_words(errors: ReferenceErrors) -> str:
    words = f"mean {errors.mean_mm:+.2f} mm, rms {errors.rms_mm:.2f} mm, worst {errors.worst_mm:+.2f} mm"
    return words if isnan(errors.inside_95) else f"{words}, {errors.inside_95:.1%} inside ± 1.96 σ"
