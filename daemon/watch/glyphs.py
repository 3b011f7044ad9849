"""The signs that the live view draws with, for terminals that know Unicode and for those that do not."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(slots=True, frozen=True)
class Glyphs:
    """Each has another shape for each meaning, so that colour is never needed."""

    digit: str  # the ink of the big digits
    old_digit: str  # the same of old numbers
    bar: str
    bar_sigma: str  # between minus and plus one sigma
    bar_empty: str
    bar_ends: tuple[str, str]
    levels: str  # of the history, from low to high
    lamps: Mapping[str, str]  # by the state of a part
    links: Mapping[str, str]  # by the state of the connection
    rule: str
    more: str  # what was cut off
    is_ascii: bool = False


UNICODE = Glyphs(
    digit="█",
    old_digit="░",
    bar="█",
    bar_sigma="▒",
    bar_empty="─",
    bar_ends=("├", "┤"),
    levels="▁▂▃▄▅▆▇█",
    lamps={"ok": "●", "ill": "▲", "waiting": "○", "off": "–"},
    links={"live": "●", "silent": "▲", "gone": "✕", "waiting": "○", "paused": "‖"},
    rule="─",
    more="…",
)
ASCII = Glyphs(
    digit="#",
    old_digit=":",
    bar="#",
    bar_sigma="+",
    bar_empty="-",
    bar_ends=("[", "]"),
    levels="_.-=+*%#",
    lamps={"ok": "*", "ill": "!", "waiting": "?", "off": "-"},
    links={"live": "*", "silent": "!", "gone": "X", "waiting": "?", "paused": "="},
    rule="-",
    more="~",
    is_ascii=True,
)

_IN_ASCII = str.maketrans(
    {"±": "+-", "σ": "s", "→": "->", "←": "<-", "·": "-", "–": "-", "×": "x", "²": "2", "°": "deg ", "√": "sqrt "}
)


def knows_unicode(environment: Mapping[str, str] = os.environ) -> bool:
    """Whether the locale says so: the first of the three that is set counts."""
    for name in ("LC_ALL", "LC_CTYPE", "LANG"):
        if environment.get(name):
            return "utf" in environment[name].lower()
    return True


def in_ascii(text: str) -> str:
    """The same in ASCII, as far as that goes."""
    return text.translate(_IN_ASCII).encode("ascii", "replace").decode()
