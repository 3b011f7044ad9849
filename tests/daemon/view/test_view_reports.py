"""Recordings are listed and handed out; reports are made one at a time, kept, and their failures told."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

from tests.daemon.view.test_view_guard import ask
from tests.daemon.view.view_kit import RunningView, daemon_at, part, report_command, status, viewing, wait_until

WRITES = (
    "import sys, os, pathlib;"
    "pathlib.Path(sys.argv[2]).write_text(f'<p>of {sys.argv[1]} at {os.getpriority(os.PRIO_PROCESS, 0)}')"
)
LOGS = (
    "import sys, time, pathlib; log = open(sys.argv[1] + '.log', 'a'); log.write('begin %f\\n' % time.monotonic());"
    "time.sleep(0.3); log.write('end %f\\n' % time.monotonic()); pathlib.Path(sys.argv[2]).write_text('x')"
)
FAILS = "import sys; print('progress', file=sys.stderr); sys.exit('ramstroke: a.mcap: no recording')"
STAYS_AWAY = "pass"
HANGS = "import time; time.sleep(600)"


def listed(view: RunningView) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = json.loads(ask(view, "/recordings").body)["recordings"]
    return rows


def state(view: RunningView, name: str = "a.mcap") -> str:
    return str(view.server.reports.rows().get(name, {}).get("state"))


def order(view: RunningView, name: str = "a.mcap") -> int:
    return ask(view, f"/recordings/{name}/report", "POST", Origin=view.url).status


def record(view: RunningView, name: str = "a.mcap", content: bytes = b"recording") -> Path:
    path = view.folder / "recordings" / name
    path.write_bytes(content)
    return path


def test_recordings_are_listed_newest_first_with_size_time_and_the_growing_one(short_path: Path) -> None:
    with viewing(short_path) as view, daemon_at(short_path / "live") as daemon:
        old, new = record(view, "old.mcap", b"12345"), record(view, "new.mcap", b"123")
        os.utime(old, (1000, 1000))
        daemon.status = status(recorder=part(file=str(new)))
        daemon.start()
        wait_until(lambda: view.server.memory.recording == str(new))
        rows = listed(view)
        assert [row["name"] for row in rows] == ["new.mcap", "old.mcap"]
        assert [(row["bytes"], row["growing"]) for row in rows] == [(3, True), (5, False)]
        assert rows[1]["changed_s"] == 1000


def test_a_folder_that_is_missing_is_an_empty_list(short_path: Path) -> None:
    with viewing(short_path) as view:
        (short_path / "recordings").rmdir()
        assert listed(view) == []


def test_a_recording_is_downloaded_as_it_is_and_in_parts(short_path: Path) -> None:
    with viewing(short_path) as view:
        content = bytes(range(256)) * 1000
        record(view, content=content)
        whole = ask(view, "/recordings/a.mcap")
        assert whole.body == content
        assert whole.headers["content-disposition"] == 'attachment; filename="a.mcap"'
        assert whole.headers["cache-control"] == "no-store"
        piece = ask(view, "/recordings/a.mcap", Range="bytes=10-19")
        assert (piece.status, piece.body) == (206, content[10:20])


def test_a_report_is_made_with_low_priority_and_served_in_a_cage(short_path: Path) -> None:
    with viewing(short_path, command=report_command(WRITES)) as view:
        path = record(view)
        assert ask(view, "/recordings/a.mcap/report").status == 404
        assert order(view) == 202
        wait_until(lambda: state(view) == "ready")
        report = ask(view, "/recordings/a.mcap/report")
        assert report.headers["content-type"].startswith("text/html")
        assert report.body.decode() == f"<p>of {path} at 19"
        policy = report.headers["content-security-policy"]
        assert "sandbox allow-scripts" in policy
        assert "allow-same-origin" not in policy
        assert "connect-src" not in policy
        assert "default-src 'none'" in policy
        assert list((short_path / "scratch").iterdir()) == [short_path / "scratch" / "a.mcap.html"]


def test_a_report_is_kept_until_the_recording_changes(short_path: Path) -> None:
    with viewing(short_path, command=report_command(LOGS)) as view:
        path = record(view)
        log = path.with_name("a.mcap.log")
        for expected in (1, 1, 2):
            if expected == 2:
                path.write_bytes(b"more of it")
            order(view)
            wait_until(lambda: state(view) == "ready")
            assert log.read_text().count("begin") == expected


def test_reports_are_made_one_at_a_time(short_path: Path) -> None:
    with viewing(short_path, command=report_command(LOGS)) as view:
        names = [f"{letter}.mcap" for letter in "abcd"]
        for name in names:
            record(view, name)
            order(view, name)
        assert sorted(state(view, name) for name in names).count("waiting") >= 3
        wait_until(lambda: all(state(view, name) == "ready" for name in names))
        lines = [
            line.split()
            for name in names
            for line in (view.folder / "recordings" / f"{name}.log").read_text().splitlines()
        ]
        order_of_events = [word for word, _ in sorted(lines, key=lambda line: float(line[1]))]
        assert order_of_events == ["begin", "end"] * 4


def test_orders_beyond_what_may_wait_are_refused(short_path: Path) -> None:
    with viewing(short_path, command=report_command(HANGS)) as view:
        answers = []
        for number in range(10):
            record(view, f"r{number}.mcap")
            answers.append(order(view, f"r{number}.mcap"))
        assert answers == [202] * 8 + [429] * 2


def test_a_failure_is_told_in_its_own_words(short_path: Path) -> None:
    for program, why in ((FAILS, "a.mcap: no recording"), (STAYS_AWAY, "no report was written")):
        with viewing(short_path, command=report_command(program)) as view:
            record(view)
            order(view)
            wait_until(lambda view=view: state(view) == "failed")  # type: ignore[misc]  # bound now
            assert view.server.reports.rows()["a.mcap"]["why"] == why
            assert list((short_path / "scratch").iterdir()) == []
            assert order(view) == 202  # it may be tried again


def test_the_end_of_the_view_ends_what_is_being_made(short_path: Path) -> None:
    beats = (
        "import sys, time, pathlib\nwhile True:\n"
        " pathlib.Path(sys.argv[1] + '.beat').write_text(str(time.monotonic())); time.sleep(0.05)"
    )
    with viewing(short_path, command=report_command(beats)) as view:
        beat = record(view).with_name("a.mcap.beat")
        order(view)
        wait_until(beat.exists)
    before = beat.read_text()
    time.sleep(0.4)
    assert beat.read_text() == before


def test_a_real_recording_gets_its_report_or_a_sentence(short_path: Path, demo_run: Any) -> None:
    with viewing(short_path) as view:
        record(view, content=demo_run.recording.read_bytes())
        order(view)
        wait_until(lambda: state(view) in ("ready", "failed"))
        row = view.server.reports.rows()["a.mcap"]
        assert row["state"] == "ready" or "-o" in row["why"]
