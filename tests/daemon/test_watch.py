"""`ramstroke watch` at terminals and in pipes, beside a daemon that says what a test wants said."""

from __future__ import annotations

import asyncio
import json
import os
import random
import re
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

import pytest

from daemon.cli import main
from daemon.service.live_client import ForbiddenError, Gone, Line, LiveLink, Silent
from daemon.watch import big_digits
from daemon.watch.glyphs import ASCII, UNICODE, Glyphs, knows_unicode
from daemon.watch.history import spark_rows
from daemon.watch.layout import Look, compose
from daemon.watch.scene import Scene
from daemon.watch.words import _TEXTS, Words
from tests.daemon.live_kit import FakeDaemon, encoded, estimate, hello, status
from tests.daemon.terminal_kit import PATIENCE_S, AtTerminal

NOBODY = 65534
ILL = {"state": "ill", "what": "the wire is open", "advice": "check the plug"}


@pytest.fixture
def config(short_path: Path) -> Path:
    path = short_path / "c.toml"
    path.write_text(f'[service]\nsocket = "{short_path}/s"\nstate_file = "{short_path}/state.json"\n')
    return path


def command(config: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "daemon.cli", "watch", "--config", str(config), *more]


@contextmanager
def piped(config: Path, *more: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(command(config, *more), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def ended(process: subprocess.Popen[bytes], number: signal.Signals = signal.SIGINT) -> tuple[bytes, bytes]:
    process.send_signal(number)
    said = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, said
    return said


def screen(scene: Scene, width: int = 80, height: int = 24, language: str = "en", glyphs: Glyphs = UNICODE) -> str:
    look = Look(width, height, Words(language), glyphs)
    lines = compose(scene, scene, None, 0, look)
    assert len(lines) == height
    assert all(line.cell_len <= width for line in lines)
    return "\n".join(line.plain.rstrip() for line in lines)


def line(content: dict[str, object]) -> Line:
    return Line(content, encoded(content))


def scene_of(*contents: dict[str, object]) -> Scene:
    scene = Scene()
    for content in contents:
        scene.take(line(content))
    return scene


def test_what_is_shown_is_what_was_sent(config: Path, short_path: Path) -> None:
    dice = random.Random(5)
    with FakeDaemon(short_path / "s") as daemon, AtTerminal(command(config), (80, 18)) as terminal:
        terminal.shows("347.2 ± 0.6 mm (1σ)", "9.8.7", "LIVE")
        for _ in range(5):
            mm, sigma, speed = dice.uniform(0, 500), dice.uniform(0, 99), dice.uniform(-90, 90)
            segment = dice.choice(["ZUPT", "VVS", "CVS"])
            state = dice.choice(["ok", "late", "stuck", "out_of_range"])
            daemon.send("estimate", estimate(mm, sigma, speed, segment=segment, can_state=state, move=17))
            shown = terminal.shows(f"{mm:.1f} ± {sigma:.1f} mm", f"{speed:+.1f} mm/s", f"({segment})", "move 17")
            assert f"displacement sensor: {state.replace('_', ' ')}" in shown
            assert shown.count("push" if speed > 0 else "retract") == 1


def test_parts_moves_and_events_are_shown_with_their_times_reasons_and_advice(config: Path, short_path: Path) -> None:
    with FakeDaemon(short_path / "s") as daemon, AtTerminal(command(config)) as terminal:
        terminal.shows("LIVE", "imu", "recorder")
        assert "jy901" not in terminal.sheet.text
        now_s, now = time.monotonic(), time.time()
        daemon.send("status", status(can=ILL | {"since_s": now_s - 3725.0}))
        daemon.send("event", {"t_s": now_s - 61.0, "what": "something came to pass"})
        row = {"kind": "retract", "onset_s": now_s - 20, "stop_s": now_s - 5, "start_mm": 499.04, "end_mm": 1.23}
        row |= {"sigma_mm": 0.45, "velocity_mm_s": -35.67, "can_state": "late", "tier": "settled"}
        daemon.send("move", row)
        shown = terminal.shows("ILL", "something came to pass", "499.0 →   1.2 ± 0.5 mm", "-35.67 mm/s", "sensor late")
        assert "the wire is open; check the plug" in shown
        for ago_s in (3725.0, 61.0, 5.0):
            clocks = [f"{datetime.fromtimestamp(now - ago_s + off):%H:%M:%S}" for off in (-1, 0, 1)]
            assert any(clock in shown for clock in clocks)


def test_what_was_before_the_view_is_shown_and_what_is_not_known_is_a_dash(config: Path, short_path: Path) -> None:
    now_s = time.monotonic()
    move = {"kind": "push", "onset_s": now_s - 20, "stop_s": now_s - 5, "start_mm": None, "end_mm": 499.5}
    move |= {"sigma_mm": 0.6, "velocity_mm_s": 14.53, "can_state": "ok", "tier": "settled"}
    greeting = hello() | {"moves": [move], "events": [{"t_s": now_s - 5, "what": "stop confirmed (push)"}]}
    with FakeDaemon(short_path / "s", encoded(greeting)), AtTerminal(command(config)) as terminal:
        shown = terminal.shows("stop confirmed (push)", "– → 499.5 ± 0.6 mm", "+14.53 mm/s")
        assert "nan" not in shown


def test_big_digits_are_shown_and_no_two_look_alike(config: Path, short_path: Path) -> None:
    with FakeDaemon(short_path / "s"), AtTerminal(command(config)) as terminal:
        rows = big_digits.big("347.2", "█")
        shown = terminal.shows(*rows).splitlines()
        first = next(i for i, text in enumerate(shown) if text.startswith(rows[0]))
        assert all(text.startswith(row) for text, row in zip(shown[first:], rows, strict=False))
    assert len({tuple(big_digits.big(one, "#")) for one in "0123456789.-?"}) == 13


def test_a_daemon_that_ends_is_told_at_once_and_its_return_too(config: Path, short_path: Path) -> None:
    with AtTerminal(command(config)) as terminal:
        terminal.shows("NO DAEMON", "no daemon answers on", "`ramstroke run`, or name", "no estimate yet")
        with FakeDaemon(short_path / "s"):
            terminal.shows("LIVE", "█")
        shown = terminal.shows("NO DAEMON", "old numbers, last heard", "Parts, as they were")
        assert big_digits.big("347.2", "█")[0] not in shown
        assert big_digits.big("347.2", "░")[0] in shown
        with FakeDaemon(short_path / "s") as daemon:
            daemon.greeting = encoded(hello(estimate(12.5)))
            shown = terminal.shows("LIVE", "██")
            assert "old numbers" not in shown


def test_a_connection_that_falls_silent_is_told(config: Path, short_path: Path) -> None:
    with FakeDaemon(short_path / "s") as daemon, AtTerminal(command(config)) as terminal:
        terminal.shows("LIVE")
        shown = terminal.shows("SILENT", "connected, but silent for 4 s", "old numbers, last heard")
        assert big_digits.big("347.2", "█")[0] not in shown
        assert "├░░░" in shown
        daemon.send("estimate", estimate())
        terminal.shows("LIVE")


@pytest.mark.parametrize("end", [b"q", b"Q", b"\x03", signal.SIGTERM, signal.SIGHUP])
def test_every_way_to_end_gives_the_terminal_back(end: bytes | signal.Signals, config: Path, short_path: Path) -> None:
    with FakeDaemon(short_path / "s"), AtTerminal(command(config)) as terminal:
        terminal.shows("LIVE", "q quit")
        assert terminal.sheet.modes == {"1049"}  # the other screen, without a cursor
        assert not termios.tcgetattr(terminal.master)[3] & termios.ECHO
        if isinstance(end, bytes):
            terminal.press(end)
        else:
            terminal.interrupt(end)
        assert terminal.ends() == 0
        assert terminal.sheet.modes == {"25"}
        assert termios.tcgetattr(terminal.master) == terminal.before
        assert b"Traceback" not in terminal.raw


def test_sleeping_gives_the_terminal_back_and_waking_takes_it_again(config: Path, short_path: Path) -> None:
    with FakeDaemon(short_path / "s") as daemon, AtTerminal(command(config)) as terminal:
        terminal.shows("LIVE")
        terminal.press(b"\x1a")
        until = time.monotonic() + PATIENCE_S
        while Path(f"/proc/{terminal.process.pid}/stat").read_text().rpartition(")")[2].split()[0] != "T":
            assert time.monotonic() < until
            terminal.read(0.02)
        terminal.read(0.1)
        assert terminal.sheet.modes == {"25"}
        assert termios.tcgetattr(terminal.master) == terminal.before
        daemon.send("estimate", estimate(111.1))
        terminal.interrupt(signal.SIGCONT)
        terminal.shows(*big_digits.big("111.1", "█"))
        assert terminal.sheet.modes == {"1049"}
        terminal.press(b"q")
        assert terminal.ends() == 0


def test_while_it_is_paused_nothing_changes_but_the_end_of_the_daemon_is_told(config: Path, short_path: Path) -> None:
    with AtTerminal(command(config), (80, 18)) as terminal:
        with FakeDaemon(short_path / "s") as daemon:
            terminal.shows("LIVE", "347.2 ±")
            terminal.press(b"\x1b[A")  # an arrow is no key of ours
            terminal.press(b"p")
            terminal.shows("PAUSED", "paused at", "p go on")
            daemon.send("estimate", estimate(222.2))
            terminal.read(1.0)
            assert "347.2 ±" in terminal.sheet.text
        terminal.shows("NO DAEMON", "paused at", "347.2 ±")
        terminal.press(b" ")
        terminal.shows("222.2 ±", "q quit   p pause")


@pytest.mark.parametrize(("width", "height"), [(140, 40), (116, 24), (60, 15), (40, 12), (24, 5), (20, 4), (3, 1)])
def test_it_follows_the_size_of_the_terminal(width: int, height: int, config: Path, short_path: Path) -> None:
    """The terminal of these tests fails when anything is written beyond its edges."""
    with FakeDaemon(short_path / "s") as daemon, AtTerminal(command(config)) as terminal:
        terminal.shows("LIVE")
        daemon.send("status", status(imu=ILL | {"what": "long " * 60}))
        terminal.resize(width, height)
        wanted = "347.2" if width < 48 else "± 0.6"
        terminal.shows(wanted if width >= 24 and height >= 5 else "terminal too small"[: width - 1])
        terminal.resize(80, 24)
        terminal.shows("LIVE", "ILL", "q quit")


def test_a_narrow_screen_shows_what_ails_before_what_is_well() -> None:
    shown = screen(scene_of(hello(loop=ILL)), 80, 18)
    assert shown.index("loop") < shown.index("imu")
    assert "the wire is open; check the plug" in shown


def test_where_there_is_no_room_for_lamps_no_part_seems_to_be_missing() -> None:
    shown = screen(scene_of(hello(displacement=ILL)), 44, 14)
    assert all(name in shown for name in ("imu", "can", "estimator", "recorder", "loop"))
    assert "check the plug" in shown


def test_without_a_terminal_it_prints_a_line_a_second_and_what_happens(config: Path, short_path: Path) -> None:
    with FakeDaemon(short_path / "s") as daemon, piped(config) as process:
        assert process.stdout is not None
        first = process.stdout.readline().decode()
        assert re.fullmatch(r"\d\d:\d\d:\d\d  347\.2 ± 0\.6 mm \(1σ\)  \+14\.5 mm/s  .*\(CVS\)  sensor ok\n", first)
        daemon.send("status", status(can=ILL))
        daemon.send("status", status(can=ILL))
        daemon.send("estimate", estimate(1.0))
        daemon.send("event", {"t_s": 1.0, "what": "it came to pass"})
        daemon.send("status", status(estimate(0.0, 200.0)))
        lines = [process.stdout.readline().decode()[10:].rstrip() for _ in range(6)]
        assert lines[1] == "can ILL: the wire is open; check the plug"
        assert "347.2" in lines[0]
        assert "347.2" in lines[2]  # and not the part a second time
        assert lines[3] == "Events: it came to pass"
        assert lines[4] == "undetermined (± 200 mm (1σ)), sensor ok"
        assert lines[5] == "can ok"
        out, said = ended(process)
    assert b"\x1b" not in out
    assert said == b""


def test_in_a_pipe_silence_and_the_end_of_the_daemon_are_told_too(config: Path, short_path: Path) -> None:
    with piped(config) as process:
        assert process.stdout is not None
        assert b"no daemon answers on" in process.stdout.readline()
        with FakeDaemon(short_path / "s"):
            assert b"347.2" in process.stdout.readline()
            assert b"connected, but silent for 3 s" in process.stdout.readline()
        assert b"has ended" in process.stdout.readline()
        assert b"no daemon answers on" in process.stdout.readline()
        ended(process, signal.SIGTERM)


def test_json_passes_the_lines_on_as_they_are(config: Path, short_path: Path) -> None:
    sent = [encoded({"type": "estimate"} | estimate(n)) for n in range(30)]
    with FakeDaemon(short_path / "s") as daemon, piped(config, "--json") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == daemon.greeting
        daemon.send_bytes(b"no line of ours\n" + b"".join(sent))
        assert [process.stdout.readline() for _ in sent] == sent
        out, said = ended(process)
        assert (out, said) == (b"", b"")


def test_a_reader_that_has_gone_ends_it(config: Path, short_path: Path) -> None:
    with FakeDaemon(short_path / "s") as daemon, piped(config, "--json") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == daemon.greeting
        process.stdout.close()
        until = time.monotonic() + PATIENCE_S
        while process.poll() is None:
            assert time.monotonic() < until
            daemon.send("estimate", estimate())
            time.sleep(0.01)
        assert process.returncode == 1
        assert process.stderr is not None
        assert process.stderr.read() == b""
        process.stdout = None


def test_damaged_lines_are_left_out_and_counted(config: Path, short_path: Path) -> None:
    bad_values: list[object] = [None, "347", True, [], {}, 1e400, 10**400, "\x1b[2J"]
    damaged = [b"\n", b"\xff\xfe\n", b"{\n", b"[]\n", b"7\n", b'{"type":5}\n', b"[" * 100_000 + b"\n"]
    damaged += [b"x" * 3_000_000 + b"\n"]
    damaged += [encoded({"type": "estimate"} | estimate() | {"displacement_mm": value}) for value in bad_values]
    damaged += [encoded({"type": "status"} | status() | {"can": value}) for value in (None, 5, {"state": 7})]
    damaged += [encoded({"type": "move"}), encoded({"type": "event", "t_s": 1.0, "what": 5})]
    with FakeDaemon(short_path / "s") as daemon, AtTerminal(command(config), (80, 18)) as terminal:
        terminal.shows("LIVE", "347.2 ±")
        for one in damaged:
            daemon.send_bytes(one)
        daemon.send("event", {"t_s": time.monotonic(), "what": "evil \x1b[31m\x07 text"})
        daemon.send("word of another version", {})
        daemon.send("estimate", estimate(123.4))
        shown = terminal.shows("123.4 ±", "damaged lines from the daemon", "evil ?[31m? text")
        counted = re.search(r"(\d+) damaged", shown)
        assert counted is not None
        assert int(counted[1]) >= len(damaged)  # the long one may count more than once
        assert b"\x1b[31m" not in terminal.raw


def test_a_viewer_that_is_refused_or_slow_is_told(config: Path, short_path: Path) -> None:
    with FakeDaemon(short_path / "s", b'{"type":"refused","viewers":16}\n') as daemon:
        with AtTerminal(command(config)) as terminal:
            terminal.shows("NO DAEMON", "serves as many viewers as it can")
            daemon.greeting = encoded(hello())
            terminal.shows("LIVE")
            daemon.send("dropped", {"lines": 37})
            terminal.shows("this terminal is too slow: 37 lines lost")
        daemon.greeting = b'{"type":"refused","viewers":16}\n'
        with piped(config) as process:
            assert process.stdout is not None
            assert b"serves as many viewers as it can" in process.stdout.readline()
            ended(process)


def test_a_user_who_may_not_is_told_which_group_to_join(
    config: Path, short_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with FakeDaemon(short_path / "s"):
        assert main(["status", "--config", str(config)]) == 0  # and all is loaded that another user may not read
        capsys.readouterr()
        (short_path / "s").chmod(0o000)
        short_path.chmod(0o755)
        was = os.geteuid()
        if was == 0:  # to whom nothing is forbidden
            os.seteuid(NOBODY)
        try:
            codes = [main(["watch", "--config", str(config), *more]) for more in ([], ["--json"])]
            codes.append(main(["status", "--config", str(config)]))
        finally:
            os.seteuid(was)
    assert codes == [1, 1, 1]
    said = capsys.readouterr()
    assert said.out == ""
    sentence = f"you may not read {short_path}/s: join the group ramstroke (`sudo usermod -aG ramstroke $USER`)"
    assert said.err == f"ramstroke: {sentence} and log in again\n" * 3


def test_colours_only_where_they_are_wanted(config: Path, short_path: Path) -> None:
    with FakeDaemon(short_path / "s", encoded(hello(can=ILL))):
        with AtTerminal(command(config)) as coloured:
            coloured.shows("LIVE", "ILL", "q quit")
            in_colours = coloured.sheet.text
        with AtTerminal(command(config), environment={"NO_COLOR": "1"}) as plain:
            plain.shows("LIVE", "ILL", "q quit")
            without = plain.sheet.text
    assert any("38;" in code for code in coloured.sheet.codes)
    assert plain.sheet.codes <= {"0", "1", "2"}
    assert re.sub(r"\d\d:\d\d:\d\d", "", in_colours) == re.sub(r"\d\d:\d\d:\d\d", "", without)


@pytest.mark.parametrize(
    ("more", "environment"), [(["--ascii"], {}), ([], {"LC_ALL": "C"}), ([], {"LC_ALL": "de_DE.ISO-8859-1"})]
)
def test_without_unicode_all_is_ascii(
    more: list[str], environment: dict[str, str], config: Path, short_path: Path
) -> None:
    greeting = encoded(hello(can=ILL | {"what": "σ is too large → 5 °C"}))
    with (
        FakeDaemon(short_path / "s", greeting),
        AtTerminal(command(config, *more), environment=environment) as terminal,
    ):
        shown = terminal.shows("* LIVE", "! can", "s is too large -> 5 deg C", "+- 0.6 mm (1s)", "* imu")
        assert shown.isascii()


def test_the_locale_tells_whether_the_terminal_knows_unicode() -> None:
    assert knows_unicode({}) is True
    assert knows_unicode({"LANG": "zh_CN.UTF-8"}) is True
    assert knows_unicode({"LANG": "zh_CN.UTF-8", "LC_ALL": "C"}) is False
    assert knows_unicode({"LANG": "C", "LC_CTYPE": "en_GB.utf8", "LC_ALL": ""}) is True


def test_chinese_fits_and_says_the_same(config: Path, short_path: Path) -> None:
    with (
        FakeDaemon(short_path / "s", encoded(hello(can=ILL))),
        AtTerminal(command(config, "--language", "zh")) as terminal,
    ):
        terminal.shows(
            "实时", "匀速段 (CVS)", "位移传感器", "故障", "the wire is open; check the plug", "退出", "位移传感器: 正常"
        )
    for english, chinese in _TEXTS.values():
        assert english.count("{0}") == chinese.count("{0}")
    scene = scene_of(hello(can=ILL))
    for width, height in ((80, 24), (140, 40), (30, 10)):
        assert len(screen(scene, width, height, "zh").splitlines()) == height


def test_a_stroke_that_is_not_known_has_no_number() -> None:
    shown = screen(scene_of(hello(estimate(250.0, 144.3))))
    assert "undetermined (± 144.3 mm (1σ))" in shown
    assert "250" not in shown
    assert "█" * 20 not in shown
    assert "├" + "▒" * 69 + "┤" in shown
    nothing = hello()
    nothing["estimate"] = None
    assert "no estimate yet" in screen(scene_of(nothing))


@pytest.mark.parametrize("mm", [-3.0, 0.0, 0.2, 125.0, 499.9, 503.0])
def test_the_bar_is_as_long_as_the_stroke(mm: float) -> None:
    bar = next(row for row in screen(scene_of(hello(estimate(mm, 10.0)))).splitlines() if row.startswith("0 ├"))
    ink = bar[3:-8]
    low, high = (min(max(value / 500 * len(ink), 0), len(ink)) for value in (mm - 10, mm + 10))
    assert abs(ink.count("█") - low) <= 0.5
    assert abs(ink.count("█") + ink.count("▒") - high) <= 0.5
    assert len(bar) == 80
    assert bar.endswith("┤ 500 mm")


def test_the_history_shows_each_value_at_its_time() -> None:
    history = [(t / 10, (t / 10) * 4.0) for t in range(1200)]  # 0 to 480 in two minutes
    for levels in (UNICODE.levels, ASCII.levels):
        rows = spark_rows(history, 500.0, 120, 60, 2, levels)
        heights = [sum(levels.index(row[column]) + 1 for row in rows if row[column] != " ") - 1 for column in range(60)]
        wanted = [(2 * column + 1) * 4.0 / 500 * 15 for column in range(60)]
        assert all(abs(height - want) < 0.6 for height, want in zip(heights, wanted, strict=True))
    gap = [point for point in history if not 60 <= point[0] < 80]
    assert spark_rows(gap, 500.0, 120, 60, 1, UNICODE.levels)[0][30:40] == " " * 10
    assert spark_rows([], 500.0, 120, 5, 2, UNICODE.levels) == [" " * 5] * 2


def test_the_history_begins_anew_with_another_clock_and_has_no_unknown_strokes() -> None:
    scene = scene_of(hello(estimate(10.0, t_s=1e6)), {"type": "estimate"} | estimate(20.0, t_s=5.0))
    scene.take(line({"type": "estimate"} | estimate(250.0, 144.0, t_s=6.0)))
    assert list(scene.history) == [(5.0, 20.0)]


def test_memory_stays_bounded() -> None:
    scene = scene_of(hello())
    for number in range(20_000):
        scene.take(line({"type": "estimate"} | estimate(t_s=1e6 + number / 10)))
        scene.take(line({"type": "event", "t_s": 1.0, "what": "e"}))
    assert len(scene.history) < 6100
    assert len(scene.events) == 50


def test_a_still_picture_writes_next_to_nothing(config: Path, short_path: Path) -> None:
    """Kind to a slow connection: what does not change is not sent again."""
    with FakeDaemon(short_path / "s") as daemon, AtTerminal(command(config)) as terminal:
        terminal.shows("LIVE", "q quit")
        daemon.send("status", status())
        terminal.read(0.6)
        whole = len(terminal.raw)
        for _ in range(10):
            daemon.send("estimate", estimate(t_s=1e9))
            terminal.read(0.1)
        assert len(terminal.raw) - whole < whole / 4


def test_a_link_tells_why_nobody_is_there_once(short_path: Path) -> None:
    path = short_path / "s"

    async def scene() -> list[str]:
        told: list[str] = []
        async for heard in LiveLink(path, retry_s=0.01).follow():
            assert not isinstance(heard, Silent)
            told.append(heard.why if isinstance(heard, Gone) else heard.kind)
            if len(told) == 1:
                daemon = FakeDaemon(path, b"SSH-2.0\n")
                await asyncio.to_thread(daemon.__enter__)
            elif len(told) == 2:
                daemon.greeting = encoded(hello())
            elif len(told) == 3:
                await asyncio.to_thread(daemon.__exit__, None, None, None)
            elif len(told) == 5:
                return told
        raise AssertionError

    first, second, third, fourth, fifth = asyncio.run(asyncio.wait_for(scene(), PATIENCE_S))
    assert "no daemon answers" in first
    assert "no ramstroke daemon" in second
    assert third == "hello"
    assert "has ended" in fourth
    assert "no daemon answers" in fifth


def test_a_link_that_becomes_forbidden_waits(short_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = short_path / "s"

    async def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    async def first() -> None:
        async for _ in LiveLink(path).follow():
            pass

    async def later() -> str:
        async for heard in LiveLink(path, retry_s=0.01).follow():
            if isinstance(heard, Line):
                monkeypatch.setattr(asyncio, "open_unix_connection", refuse)
                daemon.hang_up()
            elif isinstance(heard, Gone) and "may not" in heard.why:
                return heard.why
        raise AssertionError

    with FakeDaemon(path) as daemon:
        assert "join the group ramstroke" in asyncio.run(asyncio.wait_for(later(), PATIENCE_S))
        with pytest.raises(ForbiddenError, match="join the group ramstroke"):
            asyncio.run(first())


def test_json_of_a_whole_status_is_understood_by_the_view(config: Path, short_path: Path) -> None:
    """The fields that the view reads are those that the daemon writes."""
    from daemon.rows import estimate_row
    from daemon.service.health import HealthBook
    from drivers.condition import OK
    from tests.daemon.recording_kit import ONE_OF_EACH

    row = HealthBook().note("imu", OK, 1.0)
    assert set(row) == {"state", "since_s", "what", "advice"}
    known = json.loads(json.dumps(estimate_row(ONE_OF_EACH["/estimate/provisional"])))  # type: ignore[arg-type]
    assert set(known) == set(estimate())
