"""The report as one HTML file, whole or not at all."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from daemon.errors import CommandError
from daemon.extras import needs
from daemon.offline.report import sections
from daemon.offline.report.collecting import Collector
from daemon.offline.report.findings import move_findings, summary
from daemon.offline.report.html import Markup, element, joined, json_script
from daemon.offline.report.packing import Packed, pack
from daemon.offline.report.settings_tables import differences, settings_section
from daemon.offline.report.times import Clock
from daemon.offline.reviewing.review import Review
from daemon.offline.whole_file import whole_file
from daemon.settings import Settings

MODULES = ("main", "decoding", "levels", "timeline", "panels", "figures", "lanes", "gestures", "keys", "theme")


class ReportError(CommandError):
    """A report cannot be made; one sentence."""


@dataclass(slots=True, frozen=True)
class Chapter:
    """One recording in the report."""

    name: str
    words: Markup
    numbers: Packed
    settings: Settings


def chapter(path: Path, reviewed: Review, collected: Collector) -> Chapter:
    """What the report says and shows of one recording."""
    collected.finish()
    begin_ns = collected.first_ns or 0
    clock = Clock.of(reviewed.metadata, begin_ns)
    findings = move_findings(reviewed, collected)
    numbers = pack(collected, reviewed.replayed.moves, clock, reviewed.replayed.settings.support.stroke_mm)
    zero_ns = numbers.pop("zero_ns")
    parts = [
        sections.head(path, reviewed, collected, clock, summary(reviewed, collected, findings, clock)),
        element("h3", "Moves"),
        sections.moves_table(findings, clock, zero_ns),
        element("h3", "Over time"),
        sections.shares(reviewed),
        element("div", class_="plots"),
        element("h3", "Events, warnings and gaps"),
        sections.lines_list(collected, clock, zero_ns),
        element("h3", "Settings and versions"),
        settings_section(reviewed.replayed.settings, reviewed.metadata),
    ]
    return Chapter(path.name, joined(parts), numbers, reviewed.replayed.settings)


def require_plotly() -> str:
    """Its JavaScript. Raises ReportError."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise ReportError(needs("a report", "plotly", "offline")) from error
    # Nothing in a script may look like its end.
    return str(get_plotlyjs()).replace("</script", "<\\/script")


def write_report(path: Path, chapters: Sequence[Chapter]) -> None:
    """Put the chapters together. Raises ReportError or RecordingError."""
    plotly = require_plotly()
    page = files("daemon.offline.report") / "page"
    template = (page / "template.html").read_text(encoding="utf-8")
    imports = {
        f"report/{name}.js": "data:text/javascript;base64,"
        + base64.b64encode((page / f"{name}.js").read_bytes()).decode("ascii")
        for name in MODULES
    }
    pieces = {
        "title": joined([" · ".join(c.name for c in chapters)]),
        "style": (page / "report.css").read_text(encoding="utf-8"),
        "tabs": _tabs(chapters),
        "chapters": joined(
            [
                element(
                    "section",
                    c.words,
                    id=f"chapter-{i}",
                    class_="chapter",
                    hidden=i > 0,
                    **({"role": "tabpanel", "aria_labelledby": f"tab-{i}"} if len(chapters) > 1 else {}),
                )
                for i, c in enumerate(chapters)
            ]
        ),
        "differences": _differences(chapters),
        "imports": json.dumps({"imports": imports}),
        "plotly": plotly,
    }
    with whole_file(path) as part, part.open("w", encoding="utf-8") as stream:
        for number, text in enumerate(template.split("%%")):
            if number % 2 == 0:
                stream.write(text)
            elif text == "numbers":
                for i, c in enumerate(chapters):
                    stream.write(json_script(f"numbers-{i}", c.numbers))
            else:
                stream.write(pieces[text])


def _tabs(chapters: Sequence[Chapter]) -> Markup:
    if len(chapters) < 2:
        return Markup("")
    tabs = [
        element(
            "button",
            c.name,
            type="button",
            role="tab",
            id=f"tab-{i}",
            aria_controls=f"chapter-{i}",
            aria_selected="true" if i == 0 else "false",
            tabindex="0" if i == 0 else "-1",
        )
        for i, c in enumerate(chapters)
    ]
    return element("div", *tabs, role="tablist", aria_label="Recordings", class_="tabs")


def _differences(chapters: Sequence[Chapter]) -> Markup:
    if len(chapters) < 2:
        return Markup("")
    return element(
        "section",
        element("h2", "Differences between the files"),
        differences([(c.name, c.settings) for c in chapters]),
        class_="differences",
    )
