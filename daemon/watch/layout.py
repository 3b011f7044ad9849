"""From what is known to the lines of the screen; the same input gives the same lines."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

from rich.cells import cell_len
from rich.text import Text

from daemon.watch import big_digits
from daemon.watch.figures import figure
from daemon.watch.glyphs import Glyphs, in_ascii
from daemon.watch.history import spark_rows
from daemon.watch.scene import Part, Scene, Stroke
from daemon.watch.words import Words

WIDE = 116  # columns: parts on the left, moves and events on the right
ROOM_FOR_BIG = 20  # lines: fewer, and the stroke is written small
ROOM_FOR_DIGITS = 48  # columns
LEAST = (24, 5)
MOVING_MM_S = 1.0  # slower is no direction
PAIR_COLUMNS = 38  # each, where two parts that are well stand side by side

# Okabe and Ito's colours; each goes with a word and a sign of its own.
GREEN, ORANGE, VERMILION, BLUE = "#009E73", "#E69F00", "#D55E00", "#56B4E9"
_LAMP_STYLES = {"ok": GREEN, "ill": f"bold {VERMILION}", "waiting": f"bold {ORANGE}", "off": "dim"}
_LINK_STYLES = {
    "live": GREEN,
    "silent": f"bold {ORANGE}",
    "gone": f"bold {VERMILION}",
    "waiting": ORANGE,
    "paused": f"bold {BLUE}",
}
_MOST_MOVES = 6


@dataclass(slots=True, frozen=True)
class Look:
    """How the view is drawn: size, words, signs."""

    width: int
    height: int
    words: Words
    glyphs: Glyphs


def compose(scene: Scene, link: Scene, paused_at: float | None, unreadable: int, look: Look) -> list[Text]:
    """`look.height` lines.

    scene: what is shown; link: how the connection is now. The two differ while the view is paused, since `paused_at`.
    unreadable: lines that could not even be read.
    """
    if look.width < LEAST[0] or look.height < LEAST[1]:
        return _fitted([Text(look.words("too_small"))], look)
    is_old = link.link() != "live"
    lines = [_header(scene, link, paused_at, look)]
    lines += _messages(link, paused_at, unreadable, look)
    lines += _stroke(scene, is_old, look)
    lines += [_bar(scene, is_old, look), *_history(scene, is_old, look)]
    keys = Text(look.words("keys" if paused_at is None else "keys_paused"), "dim")
    room = look.height - len(lines) - 1
    lines += (_side_by_side if look.width >= WIDE else _stacked)(scene, is_old, look, room)
    return [*_fitted(lines, look)[: look.height - 1], _fitted([keys], look)[0]]


def _header(scene: Scene, link: Scene, paused_at: float | None, look: Look) -> Text:
    state = "paused" if paused_at is not None and link.link() == "live" else link.link()
    left = f"ramstroke {scene.version}".rstrip()
    right = f"{look.glyphs.links[state]} {look.words(state)}"
    clock = f"  {_clock(link.heard)}" if link.heard is not None else ""
    made = Text().append(left, "bold")
    made.append(" " * max(look.width - cell_len(left) - cell_len(right) - len(clock), 1))
    made.append(right, _LINK_STYLES[state])
    return made.append(clock)


def _messages(link: Scene, paused_at: float | None, unreadable: int, look: Look) -> list[Text]:
    """What must be known before any number is believed; one empty line where all is well."""
    said: list[Text] = []
    state, words = link.link(), look.words
    if state == "gone":
        assert link.gone is not None
        said += [Text(line, f"bold {VERMILION}") for line in _wrapped(link.gone, look.width)]
    elif state == "silent":
        said.append(Text(words("silent_for", f"{link.silent_s():.0f}"), f"bold {ORANGE}"))
    if state in ("gone", "silent") and link.heard is not None:
        said.append(Text(words("old", _clock(link.heard)), f"bold {ORANGE}"))
    if paused_at is not None:
        said.append(Text(words("paused_since", _clock(paused_at)), f"bold {BLUE}"))
    if link.lost:
        said.append(Text(words("lost", link.lost), ORANGE))
    if damaged := link.damaged + unreadable:
        said.append(Text(words("damaged", damaged), ORANGE))
    return said or [Text("")]


def _stroke(scene: Scene, is_old: bool, look: Look) -> list[Text]:
    """The stroke in big digits, beside it what belongs to it."""
    words, stroke = look.words, scene.stroke
    if stroke is None:
        number, facts = "?", [words("no_estimate")]
    else:
        number = "?" if scene.is_undetermined else f"{stroke.displacement_mm:.1f}"
        facts = _facts(scene, stroke, words)
    style = "dim" if is_old else "bold"
    if look.height < ROOM_FOR_BIG or look.width < ROOM_FOR_DIGITS:
        first = Text(f"{number} {facts[0]}", style)
        return [first, Text("  ".join(facts[1:3])), Text("  ".join(facts[3:]))]
    rows = big_digits.big(number, look.glyphs.old_digit if is_old else look.glyphs.digit)
    left = max(map(len, rows)) + 3
    made = []
    for row, fact in zip(rows, [*facts, *[""] * big_digits.ROWS], strict=False):
        line = Text().append(row.ljust(left), style)
        made.append(line.append(fact, "dim" if is_old else ""))
    return made


def _facts(scene: Scene, stroke: Stroke, words: Words) -> list[str]:
    sigma = f"± {stroke.sigma_mm:.1f} {words('sigma')}"
    if scene.is_undetermined:
        sigma = f"{words('undetermined')} ({sigma})"
    return [
        sigma,
        _speed(stroke.velocity_mm_s, words),
        words(stroke.segment),
        f"{words('sensor')}: {words.sensor(stroke.can_state)}",
        f"{words('move')} {stroke.move}",
    ]


def _speed(velocity_mm_s: float, words: Words) -> str:
    way = "" if abs(velocity_mm_s) < MOVING_MM_S else words("push" if velocity_mm_s > 0 else "retract")
    return f"{round(velocity_mm_s, 1) + 0.0:+.1f} mm/s  {way}".rstrip()


def _bar(scene: Scene, is_old: bool, look: Look) -> Text:
    """The ram between its stops, and where it may be within one sigma."""
    glyphs, full = look.glyphs, f"{scene.stroke_mm:.0f} mm"
    full_ink = glyphs.old_digit if is_old else glyphs.bar
    cells = look.width - len(full) - 5
    ink = [glyphs.bar_empty] * cells
    if scene.stroke is not None:
        at, sigma = scene.stroke.displacement_mm, scene.stroke.sigma_mm
        per_mm = cells / scene.stroke_mm
        low, mid, high = (
            min(max(round(value * per_mm), 0), cells)
            for value in ((0.0 if scene.is_undetermined else at - sigma), at, at + sigma)
        )
        if scene.is_undetermined:
            low = mid = 0
            high = cells
        ink[:low] = full_ink * low
        ink[low:high] = glyphs.bar_sigma * (high - low)
        if high == low and mid:
            ink[mid - 1] = full_ink
    made = Text("0 ").append(glyphs.bar_ends[0]).append("".join(ink), "dim" if is_old else BLUE)
    return made.append(f"{glyphs.bar_ends[1]} {full}")


def _history(scene: Scene, is_old: bool, look: Look) -> list[Text]:
    rows = 1 if look.height < ROOM_FOR_BIG else min(look.height - 22, 8)
    columns = look.width - 5 - len(f"{scene.stroke_mm:.0f} mm")
    seconds = 120 if columns < 100 else 240
    drawn = spark_rows(scene.history, scene.stroke_mm, seconds, columns, rows, look.glyphs.levels)
    made = [Text(" " * 3).append(row, "dim" if is_old else BLUE) for row in drawn]
    made[-1].append(f" {look.words('last_time', seconds)}", "dim")
    return made


def _stacked(scene: Scene, is_old: bool, look: Look, room: int) -> list[Text]:
    """Parts, then moves and events in what is left; what ails comes before all else."""
    lines = _parts(scene, is_old, look, look.width, room)
    left = room - len(lines)
    moves = min(max(len(scene.moves), 1), _MOST_MOVES, max((left - 2) // 2, 0))
    lines += _moves(scene, look, look.width, moves + 1) if moves else []
    events = room - len(lines)
    return lines + (_events(scene, look, look.width, events) if events > 1 else [])


def _side_by_side(scene: Scene, is_old: bool, look: Look, room: int) -> list[Text]:
    width = look.width // 2 - 2
    left = _parts(scene, is_old, look, width, room)
    moves = min(max(len(scene.moves), 1), _MOST_MOVES, max(room // 2 - 1, 1))
    right = _moves(scene, look, look.width - width - 3, moves + 1)
    right += _events(scene, look, look.width - width - 3, room - len(right))
    made = []
    for row in range(max(len(left), len(right))):
        line = left[row].copy() if row < len(left) else Text("")
        line.truncate(width, pad=True)
        made.append(line.append("   ").append_text(right[row] if row < len(right) else Text("")))
    return made


def _parts(scene: Scene, is_old: bool, look: Look, width: int, room: int) -> list[Text]:
    """Those that ail first, with reason and advice; the others in pairs."""
    shown = [part for part in scene.parts if part.name != "jy901" or part.state != "off"]
    ailing = [part for part in shown if part.what]
    well = [part for part in shown if not part.what]
    title = look.words("parts_then" if is_old else "parts")
    lines = [_title(title, look, width)] if shown else []
    for part in ailing:
        because = f"{part.what}; {part.advice}" if part.advice else part.what
        lines.append(_lamp(part, is_old, look))
        lines += [Text("  " + line) for line in _wrapped(because, width - 2)]
    per_row = 2 if width >= 2 * PAIR_COLUMNS else 1
    if len(lines) + -(-len(well) // per_row) > room:
        return lines + _well_in_short(well, is_old, look, width)
    for first in range(0, len(well), per_row):
        line = Text("")
        for part in well[first : first + per_row]:
            lamp = _lamp(part, is_old, look)
            line.append_text(lamp).append(" " * max(width // per_row - lamp.cell_len, 1))
        lines.append(line)
    return lines


def _well_in_short(well: Sequence[Part], is_old: bool, look: Look, width: int) -> list[Text]:
    """Where there is no room for their lamps: none may seem to be missing."""
    names = ", ".join(look.words(part.name) for part in well if part.state == "ok")
    text = f"{look.glyphs.lamps['ok']} {look.words('part_ok')}: {names}"
    return [Text(line, "dim" if is_old else GREEN) for line in _wrapped(text, width)] if names else []


def _lamp(part: Part, is_old: bool, look: Look) -> Text:
    words = look.words
    name = words(part.name)
    padded = name + " " * max(13 - cell_len(name), 1)
    style = "dim" if is_old else _LAMP_STYLES.get(part.state, "")
    made = Text().append(look.glyphs.lamps.get(part.state, "?"), style)
    made.append(f" {padded}").append(words(f"part_{part.state}"), style)
    return made.append(f" {words('since')} {_clock(part.since)}", "dim" if not part.what else "")


def _moves(scene: Scene, look: Look, width: int, room: int) -> list[Text]:
    words = look.words
    lines = [_title(words("moves"), look, width)]
    for move in list(scene.moves)[::-1][: room - 1]:
        kind = words(move.kind)
        told = [
            _clock(move.stop),
            kind + " " * max(8 - cell_len(kind), 0),
            f"{figure(move.start_mm, '5.1f')} → {figure(move.end_mm, '5.1f')} ± {figure(move.sigma_mm, '.1f')} mm",
            f"{figure(move.velocity_mm_s, '+6.2f')} mm/s",
            f"{words('sensor_short')} {words.sensor(move.can_state)}",
        ]
        lines.append(Text("  ".join(told)))
    return lines if len(lines) > 1 else [*lines, Text(words("none_yet"), "dim")]


def _events(scene: Scene, look: Look, width: int, room: int) -> list[Text]:
    """The newest first."""
    lines = [_title(look.words("events"), look, width)]
    for event in reversed(scene.events):
        if len(lines) == room:
            break
        lines.append(Text(f"{_clock(event.at)}  {event.what}"))
    return lines[:room] if len(lines) > 1 else [*lines, Text(look.words("none_yet"), "dim")][:room]


def _title(text: str, look: Look, width: int) -> Text:
    made = Text().append(text, "bold")
    return made.append(" " + look.glyphs.rule * max(width - cell_len(text) - 1, 0), "dim")


def _clock(wall: float) -> str:
    return f"{datetime.fromtimestamp(wall):%H:%M:%S}"


def _wrapped(text: str, width: int) -> Sequence[str]:
    return textwrap.wrap(text, max(width, 10)) or [""]


def _fitted(lines: Sequence[Text], look: Look) -> list[Text]:
    """Exactly the height, each line within the width, in signs that the terminal knows."""
    made = [_fit(line, look.width, look.glyphs) for line in lines[: look.height]]
    return made + [Text("")] * (look.height - len(made))


def _fit(line: Text, width: int, glyphs: Glyphs) -> Text:
    if glyphs.is_ascii and not line.plain.isascii():
        line = _translated(line, in_ascii)
    if line.cell_len <= width:
        return line
    cut = line.copy()
    cut.truncate(width - len(glyphs.more))
    return cut.append(glyphs.more)


def _translated(line: Text, translate: Callable[[str], str]) -> Text:
    made = Text("")
    for part in line.divide(sorted({edge for span in line.spans for edge in (span.start, span.end)})):
        style = part.spans[0].style if part.spans else part.style
        made.append(translate(part.plain), style)
    return made
