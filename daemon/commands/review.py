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
    "Sum up recordings: contents, gaps, faults, sensor health, moves, and the errors against the reference "
    "sensor if there is one. The moves are estimated anew from what was received, and smoothed: at each step "
    "with what came after it. With -o all of it as one HTML file with plots that works offline; tables and "
    "pictures with --csv, --parquet and --png."
)
EXAMPLE = "ramstroke review /var/lib/ramstroke/recordings/ramstroke-20260105T063000Z.mcap -o shift.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("files", type=Path, nargs="*", metavar="file", help="recordings, one after the other")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="REPORT.html", help="write plots, moves, events and settings to this page"
    )
    methods.configure(parser)
    parser.add_argument(
        "--methods", metavar="NAME,NAME", help="with -o: what these methods say, as further lines beside ours"
    )
    parser.add_argument(
        "--csv", type=Path, metavar="DIR", help="write tables of steps, moves, samples ... here, as CSV"
    )
    parser.add_argument("--parquet", type=Path, metavar="DIR", help="the same tables as Parquet")
    parser.add_argument("--png", type=Path, metavar="DIR", help="pictures for papers here, each as PNG and PDF")
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
    from daemon.offline.alignment.allan import allan
    from daemon.offline.alignment.allan_plot import plot_allan
    from daemon.offline.reviewing.mount import review_mount
    from daemon.offline.reviewing.outputs import Wanted, review_to

    if arguments.method == "list" or arguments.methods == "list":
        return methods.show()
    _check(arguments)
    method, others = methods.known(arguments.method), methods.several(arguments.methods)
    wanted = Wanted(arguments.output, arguments.csv, arguments.parquet, arguments.png)
    with terminal.progress("reviewing", 1.0) as progress:
        all_reviewed = review_to(arguments.files, wanted, method, others, progress)
    told = []
    for path, reviewed in zip(arguments.files, all_reviewed, strict=True):
        with terminal.progress("mount and noise", 1.0) as progress:
            mount = review_mount(path, progress) if arguments.estimate_mount else None
            noise = allan(path, progress) if arguments.allan else None
        if noise is not None and arguments.plot is not None:
            plot_allan(arguments.plot, noise)
        if arguments.json:
            told.append(_row(path, method, reviewed, mount, noise))
            continue
        if path != arguments.files[0]:
            terminal.say("")
        _print(path, reviewed, mount)
        if arguments.plot is not None:
            terminal.say(f"Picture: {arguments.plot}")
        if noise is not None:
            _print_noise(noise)  # last: the grade at its end is for pasting
    if arguments.json:
        terminal.print_json(told[0] if len(told) == 1 else {"files": told})
        return 0
    if wanted.report is not None:
        terminal.say(f"Report: {wanted.report}")
    for folder in wanted.folders.values():
        terminal.say(f"Written: {folder}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    from daemon.errors import UsageError
    from daemon.recording.errors import refuse_same_file

    if not arguments.files:
        raise UsageError("name the recording to review")
    if len(set(arguments.files)) < len(arguments.files):
        raise UsageError("a recording is named twice; once is enough")
    if arguments.methods is not None and arguments.output is None:
        raise UsageError("--methods adds lines to the report: name -o REPORT.html beside it")
    if arguments.method != methods.OURS and (arguments.output is not None or arguments.png is not None):
        raise UsageError("report and pictures show our estimate: name other methods with --methods and -o")
    if arguments.plot is not None:
        if not arguments.allan:
            raise UsageError("--plot draws the Allan deviation: name --allan beside it")
        if len(arguments.files) > 1:
            raise UsageError("--plot is one picture: name one recording")
        refuse_same_file(arguments.files[0], arguments.plot)


def _row(path: Path, method: str, reviewed: Review, mount: MountReview | None, noise: Allan | None) -> dict[str, Any]:
    from daemon import terminal
    from daemon.offline.alignment import allan_report

    result = reviewed.replayed
    return {
        "file": str(path),
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
