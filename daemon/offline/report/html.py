"""Elements of a page. Every text passes through here, so that none of it can become markup."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape


class Markup(str):
    """Text that is markup already."""

    __slots__ = ()


def element(name: str, *content: str, **attributes: str | float | bool | None) -> Markup:
    """An element; `class_` is class, other underscores are hyphens; None and False leave an attribute out."""
    written = ""
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        key = key.rstrip("_").replace("_", "-")
        written += f" {key}" if value is True else f' {key}="{escape(str(value))}"'
    return Markup(f"<{name}{written}>{joined(content)}</{name}>")


def joined(content: Sequence[str]) -> Markup:
    """Markup as it is, text escaped."""
    return Markup("".join(part if isinstance(part, Markup) else escape(part) for part in content))


def json_script(identity: str, value: object) -> Markup:
    """Data for scripts; nothing in it can end the element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(f'<script type="application/json" id="{escape(identity)}">{text}</script>')


def table(caption: str, head: Sequence[str], rows: Sequence[Sequence[str]], class_: str = "") -> Markup:
    """A table that can be scrolled sideways; the first column names the rows. Cells that are elements stay."""
    heads = joined([element("th", text, scope="col") for text in head])
    body = joined(
        [
            element(
                "tr",
                *(
                    cell if _is_cell(cell) else element("th" if i == 0 else "td", cell, **_scope(i))
                    for i, cell in enumerate(row)
                ),
            )
            for row in rows
        ]
    )
    made = element(
        "table",
        element("caption", caption),
        element("thead", element("tr", heads)),
        element("tbody", body),
        class_=class_ or None,
    )
    return element("div", made, class_="scroll", tabindex="0", role="region", aria_label=caption)


def _is_cell(cell: str) -> bool:
    return isinstance(cell, Markup) and cell.startswith(("<td", "<th"))


def _scope(place: int) -> dict[str, str]:
    return {"scope": "row"} if place == 0 else {}
