"""The guide to trouble quotes the program in words that the program still says."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "docs" / "troubleshooting.md"
OF_THE_SYSTEM = {"No such file or directory", "Permission denied", "Connection refused"}
QUOTE = re.compile(r"`([^`]+)`")


def test_every_sentence_of_the_guide_stands_in_the_sources() -> None:
    texts = "\n".join(_texts_of_the_program())
    said = list(_fragments_quoted())
    assert len(said) > 80
    assert [fragment for fragment in said if fragment not in texts] == []


def _fragments_quoted() -> Iterator[str]:
    """What stands in the first column as code, cut where the guide leaves out a name or number."""
    for line in GUIDE.read_text(encoding="utf-8").splitlines():
        if not line.startswith("| ") or line.startswith(("| what you see", "| counter", "| state", "| ---")):
            continue
        first = line.split(" | ")[0].removeprefix("| ")
        for quote in QUOTE.findall(first):
            for fragment in quote.split("…"):
                fragment = fragment.strip(" :;()?")
                if fragment and fragment not in OF_THE_SYSTEM and not fragment.startswith("--"):
                    yield fragment


def _texts_of_the_program() -> Iterator[str]:
    for folder in ("daemon", "drivers", "estimation"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    yield from (node.value, node.value.replace("_", " "))
                elif isinstance(node, ast.Name | ast.Attribute):
                    # Counters are shown under their names, underscores as spaces; faults in small letters.
                    name = node.id if isinstance(node, ast.Name) else node.attr
                    yield from (name, name.replace("_", " "), name.lower())
