"""Digits that can be read from the other side of the roadway."""

from __future__ import annotations

ROWS = 5
_COLUMNS_PER_DOT = 2  # a cell of a terminal is twice as high as wide

_SHAPES = {
    "0": ("###", "# #", "# #", "# #", "###"),
    "1": (" # ", "## ", " # ", " # ", "###"),
    "2": ("###", "  #", "###", "#  ", "###"),
    "3": ("###", "  #", "###", "  #", "###"),
    "4": ("# #", "# #", "###", "  #", "  #"),
    "5": ("###", "#  ", "###", "  #", "###"),
    "6": ("###", "#  ", "###", "# #", "###"),
    "7": ("###", "  #", "  #", "  #", "  #"),
    "8": ("###", "# #", "###", "# #", "###"),
    "9": ("###", "# #", "###", "  #", "###"),
    ".": (" ", " ", " ", " ", "#"),
    "-": ("  ", "  ", "##", "  ", "  "),
    "?": ("###", "  #", " ##", "   ", " # "),
    " ": (" ", " ", " ", " ", " "),
}


def big(text: str, ink: str) -> list[str]:
    """`text`, of digits, point, minus and question mark, as `ROWS` lines of equal width."""
    shapes = [_SHAPES[character] for character in text]
    return [
        "  ".join(
            "".join((ink if dot == "#" else " ") * _COLUMNS_PER_DOT for dot in shape[row]) for shape in shapes
        ).rstrip()
        for row in range(ROWS)
    ]
