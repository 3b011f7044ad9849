"""The parts of the page that are words and tables."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from pathlib import Path

from daemon.offline.report.collecting import Collector, Line
from daemon.offline.report.findings import STANDS_NS, MoveFinding, words
from daemon.offline.report.html import Markup, element, joined, table
from daemon.offline.report.times import Clock
from daemon.offline.reviewing.review import Review

_GAP_LINES = 500
_MARK = {True: "✓", False: "▲"}


def head(path: Path, reviewed: Review, collected: Collector, clock: Clock, said: Sequence[tuple[bool, str]]) -> Markup:
    """What the file is, and the verdict."""
    verdict = [
        element("li", element("span", _MARK[good], aria_hidden="true"), f" {words_}", class_="good" if good else "ill")
        for good, words_ in said
    ]
    result, metadata = reviewed.replayed, reviewed.metadata
    begin_ns, end_ns = collected.first_ns, collected.last_ns
    same = {True: "reproduced bit for bit", False: "NOT reproduced", None: "none recorded to compare with"}
    facts = [
        ("Sensor", reviewed.sensor or "not named"),
        ("Begin", "–" if begin_ns is None else clock.day(begin_ns)),
        ("End", "–" if end_ns is None else clock.day(end_ns)),
        ("Times", clock.name),
        ("Duration", _duration(result.duration_s)),
        ("Samples", f"{result.samples:,} good, {sum(reviewed.faults.values()):,} bad"),
        ("File", "complete" if reviewed.complete else "cut short or still being written"),
        ("Messages lost", f"{reviewed.lost:,}"),
        ("Estimates", same[result.identical]),
        ("Recorded by", f"ramstroke {metadata.get('version', '?')} ({metadata.get('kind', 'recording')})"),
    ]
    return joined(
        [
            element("h2", path.name),
            element("ul", *verdict, class_="verdict", aria_label="Verdict"),
            element("dl", *(element("div", element("dt", name), element("dd", value)) for name, value in facts)),
            *(element("p", f"Damage: {sentence}", class_="note") for sentence in result.damage),
            *(
                element("p", f"{name} cannot be used on this recording: {why}", class_="note")
                for name, why in reviewed.refused.items()
            ),
        ]
    )


def moves_table(findings: Sequence[MoveFinding], clock: Clock, begin_ns: int) -> Markup:
    """A row a move; each zooms the plots there."""
    if not findings:
        return element("p", "No moves were found.", class_="note")
    has_reference = any(not isnan(finding.reference_mm) for finding in findings)
    methods = list(dict.fromkeys(name for finding in findings for name in finding.others_mm))
    heads = [
        "move", "verdict", "onset", "stop", "start mm", "end mm", "± 1σ", "smoothed end mm", "± 1σ", "before stop mm",
        "± 1σ", "mm/s", "largest innovation mm", *(["reference mm"] if has_reference else []),
        *(f"{name} mm" for name in methods),
    ]  # fmt: skip
    rows = [
        _move_row(number, finding, clock, begin_ns, has_reference, methods)
        for number, finding in enumerate(findings, start=1)
    ]
    return table("Moves: stroke at the end of each, in millimetres", heads, rows, class_="moves")


def _move_row(
    number: int, finding: MoveFinding, clock: Clock, begin_ns: int, has_reference: bool, methods: Sequence[str]
) -> list[str]:
    move, smoothed = finding.move, finding.smoothed
    nan = float("nan")
    ends = (
        move.start_m * 1e3,
        move.end_m * 1e3,
        move.sigma_m * 1e3,
        nan if smoothed is None else smoothed.last.displacement_m * 1e3,
        nan if smoothed is None else smoothed.last.sigma_m * 1e3,
        move.end_before_stop_m * 1e3,
        move.sigma_before_stop_m * 1e3,
    )
    return [
        _zoom_cell("th", f"{move.kind} {number}", move.onset_ns, move.stop_ns + STANDS_NS, begin_ns),
        element(
            "td",
            element("span", _MARK[finding.is_good], aria_hidden="true"),
            f" {finding.verdict}",
            class_="good" if finding.is_good else "ill",
        ),
        clock.time(move.onset_ns),
        clock.time(move.stop_ns),
        *(_number(value) for value in ends),
        _number(move.velocity_m_s * 1e3, 2),
        _number(finding.largest_innovation_mm, sign=True),
        *([_number(finding.reference_mm)] if has_reference else []),
        *(_number(finding.others_mm.get(name, nan)) for name in methods),
    ]


def lines_list(collected: Collector, clock: Clock, begin_ns: int) -> Markup:
    """Events, warnings of the log and gaps in order of time; each zooms the plots there."""
    gaps = [
        Line(last_ns, "gap", f"no inertial samples for {(next_ns - last_ns) * 1e-9:.3f} s")
        for last_ns, next_ns in collected.gaps[:_GAP_LINES]
    ]
    lines = sorted([*collected.lines, *gaps], key=lambda line: line.t_ns)
    if not lines:
        return element("p", "Nothing was said.", class_="note")
    items = [
        element(
            "li",
            _zoom_button(clock.time(line.t_ns, 3), line.t_ns, line.t_ns, begin_ns),
            element("span", line.kind, class_=f"kind {line.kind}"),
            element("span", line.text),
        )
        for line in lines
    ]
    more = collected.lines_not_shown
    return joined(
        [
            element(
                "div",
                element("ol", *items),
                class_="scroll lines",
                tabindex="0",
                role="region",
                aria_label="Events and warnings",
            ),
            *(
                [element("p", f"... and {more:,} lines more, which the recording holds.", class_="note")]
                if more
                else []
            ),
        ]
    )


def shares(reviewed: Review) -> Markup:
    """How the time was spent, in words: the plots' alternative."""
    said = []
    for title, counts in (("Time in segments", reviewed.segments), ("displacement sensor", reviewed.can_states)):
        total = sum(counts.values())
        if total:
            shares_ = ", ".join(f"{words(str(name))} {count / total:.1%}" for name, count in counts.items())
            said.append(f"{title}: {shares_}")
    settled = reviewed.reference.settled()
    if settled is not None:
        said.append(
            f"against the reference ({settled.readings} readings): mean {settled.mean_mm:+.2f} mm, "
            f"rms {settled.rms_mm:.2f} mm, worst {settled.worst_mm:+.2f} mm"
            + ("" if isnan(settled.inside_95) else f", {settled.inside_95:.1%} inside the stated 95 %")
        )
    return element("p", "; ".join(said) + "." if said else "There is nothing to plot.", class_="note")


def _zoom_cell(name: str, text: str, from_ns: int, until_ns: int, begin_ns: int) -> Markup:
    return element(name, _zoom_button(text, from_ns, until_ns, begin_ns), scope="row")


def _zoom_button(text: str, from_ns: int, until_ns: int, begin_ns: int) -> Markup:
    return element(
        "button",
        text,
        type="button",
        class_="zoom",
        data_from=f"{(from_ns - begin_ns) * 1e-9:.6f}",
        data_until=f"{(until_ns - begin_ns) * 1e-9:.6f}",
    )


def _number(value: float, digits: int = 1, *, sign: bool = False) -> str:
    if isnan(value):
        return "–"
    return f"{value:+.{digits}f}" if sign else f"{value:.{digits}f}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min {rest} s"
    return f"{minutes} min {rest} s" if minutes else f"{seconds:.1f} s"
