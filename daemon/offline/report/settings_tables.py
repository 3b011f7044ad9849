"""Settings and versions of a recording: what differs from the defaults, all of it, and what differs between files."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from daemon.offline.report.html import Markup, element, joined, table
from daemon.settings import Settings

Flat = dict[str, str]


def flat(tree: Mapping[str, Any], path: str = "") -> Flat:
    """Every value under its whole name."""
    found: Flat = {}
    for key, value in tree.items():
        name = f"{path}.{key}" if path else key
        if isinstance(value, dict) and value:
            found |= flat(value, name)
        else:
            found[name] = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return found


def settings_section(settings: Settings, metadata: Mapping[str, str]) -> Markup:
    """What differs from the defaults first, the rest to unfold."""
    own, usual = flat(settings.model_dump(mode="json")), flat(Settings().model_dump(mode="json"))
    changed = [(name, value, usual.get(name, "–")) for name, value in own.items() if usual.get(name, "null") != value]
    versions = [(name, value) for name, value in metadata.items() if name != "settings"]
    return joined(
        [
            table("Settings that differ from the defaults", ("setting", "value", "default"), changed, "settings")
            if changed
            else element("p", "All settings have their defaults."),
            element(
                "details",
                element("summary", f"All {len(own)} settings, and what the file says of itself"),
                table("What the file says of itself", ("name", "value"), versions, "settings"),
                table("All settings", ("setting", "value"), list(own.items()), "settings"),
            ),
        ]
    )


def differences(named: Sequence[tuple[str, Settings]]) -> Markup:
    """Settings that are not the same in all files."""
    columns = [flat(settings.model_dump(mode="json")) for _, settings in named]
    names = list(dict.fromkeys(name for column in columns for name in column))
    rows = [(name, *values) for name in names if len(set(values := [column.get(name, "–") for column in columns])) > 1]
    if not rows:
        return element("p", "All files were made with the same settings.", class_="note")
    return table("Settings that differ between the files", ("setting", *(name for name, _ in named)), rows, "settings")
