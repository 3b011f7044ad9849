"""A report read back, by the standard library alone."""

from __future__ import annotations

import base64
import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.data: dict[str, Any] = {}
        self.tables: dict[str, list[list[str]]] = {}
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self._script: str | None = None
        self._in_script = self._in_cell = False
        self._caption: list[str] | None = None
        self._rows: list[list[str]] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        named = dict(attributes)
        self.elements.append((tag, named))
        if tag == "script":
            self._in_script = True
            self._script = named.get("id") if named.get("type") == "application/json" else None
        elif tag == "table":
            self._rows = []
        elif tag == "caption":
            self._caption = []
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("td", "th"):
            self._rows[-1].append("")
            self._in_cell = True

    def handle_endtag(self, tag: str) -> None:
        if tag == "script":
            self._in_script, self._script = False, None
        elif tag in ("td", "th"):
            self._in_cell = False
        elif tag == "caption":
            self.tables["".join(self._caption or ())] = self._rows
            self._caption = None

    def handle_data(self, data: str) -> None:
        if self._in_script:
            if self._script is not None:
                self.data[self._script] = json.loads(data)
            return
        self.text.append(data)
        if self._caption is not None:
            self._caption.append(data)
        elif self._in_cell:
            self._rows[-1][-1] += data


class ReportPage:
    """What a report says and holds."""

    def __init__(self, path: Path) -> None:
        reader = _Reader()
        self.source = path.read_text(encoding="utf-8")
        reader.feed(self.source)
        reader.close()
        self.text = " ".join(" ".join(reader.text).split())
        self.elements = reader.elements
        self.tables = reader.tables
        self.numbers = [reader.data[f"numbers-{i}"] for i in range(len(reader.data))]

    def table(self, begin: str) -> list[dict[str, str]]:
        """The first table whose caption begins so, a dictionary a row; equal names are numbered."""
        head, *rows = next(rows for caption, rows in self.tables.items() if caption.startswith(begin))
        names = [name if head[:i].count(name) == 0 else f"{name} {head[:i].count(name)}" for i, name in enumerate(head)]
        return [dict(zip(names, (cell.strip() for cell in row), strict=True)) for row in rows]


def array_of(text: str, kind: str = "<f4") -> NDArray[Any]:
    """An embedded array."""
    return np.frombuffer(base64.b64decode(text), dtype=kind)
