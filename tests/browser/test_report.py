"""The report in a browser: values, zoom, rows, keys, fingers, accessibility."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

from daemon.cli import main
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import Health, LogLine
from daemon.recording.writer import RecordingWriter
from tests.browser.conftest import DESKTOP, PHONE, SMALL, OpenPage
from tests.browser.report_pages import open_report, shown, stretch, until

REGRESSION = Path(__file__).parent.parent / "data" / "regression"
PARTIAL = REGRESSION / "partial_push_and_retract.mcap"
SICK = REGRESSION / "another_sensor_and_a_sick_bus.mcap"
NASTY = '</script><script>document.title = "broken"</script><img src=x onerror="document.title = 1">'


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings, one of them with log lines, health and another method."""
    folder = tmp_path_factory.mktemp("report")
    source, wordy = Recording(PARTIAL), folder / "wordy.mcap"
    with RecordingWriter(wordy, source.metadata, source.attachments) as writer:
        for topic, record in source.messages():
            writer.write(topic, record)
        for second in range(25):
            state = {"state": "ill" if 8 <= second < 12 else "ok", "what": NASTY if second == 8 else ""}
            writer.write(topics.HEALTH, Health(second * 10**9, json.dumps({"imu": state, "can": {"state": "ok"}})))
        writer.write(topics.LOG, LogLine(8 * 10**9, 30, "daemon", NASTY))
    path = folder / "report.html"
    assert main(["review", str(wordy), str(SICK), "-o", str(path), "--methods", "clock"]) == 0
    return path


@pytest.fixture(scope="module")
def moves() -> list[Any]:
    return [record for _, record in Recording(PARTIAL).messages((topics.MOVES,))]


@pytest.fixture(scope="module")
def settled() -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Seconds of the record and millimetres, as recorded."""
    first = min(
        topics.TOPICS[topic].time_ns(record)
        for topic, record in Recording(PARTIAL).messages((topics.IMU_RAW, topics.CAN_RX))
    )
    rows = [
        ((record.t_ns - first) * 1e-9, record.displacement_m * 1e3)  # type: ignore[union-attr]  # the topic holds estimates
        for _, record in Recording(PARTIAL).messages((topics.SETTLED,))
    ]
    t_s, mm = np.array(rows).T
    return t_s, mm


def test_values_are_those_of_the_recording(open_page: OpenPage, report: Path, settled: Any) -> None:
    page = open_page(SMALL)
    open_report(page, report)
    t_s, mm = settled
    trace = shown(page, "stroke")["estimate (settled)"]
    assert trace["t"] == pytest.approx(t_s, abs=2e-6)
    assert trace["y"] == pytest.approx(mm, abs=1e-4)
    assert page.title() != "broken"
    assert NASTY in page.inner_text("main")


def test_a_row_of_the_table_zooms_all_plots_to_its_move(open_page: OpenPage, report: Path, moves: Any) -> None:
    page = open_page(SMALL)
    open_report(page, report)
    whole = stretch(page)
    page.get_by_role("button", name="push 2").click()
    begin, end = stretch(page)
    first_s = moves[1].onset_ns * 1e-9
    assert begin < first_s < moves[1].stop_ns * 1e-9 < end
    assert end - begin < 0.5 * (whole[1] - whole[0])
    page.evaluate("ramstroke.chapters[0].drawAll()")
    for key in ("stroke", "velocity", "acceleration"):
        times = [t for trace in shown(page, key).values() for t in trace["t"] if t is not None]
        assert begin - 0.05 * (end - begin) <= min(times)
        assert max(times) <= end + 0.05 * (end - begin)
    axis = page.evaluate("document.querySelector('[data-panel=stroke]').layout.xaxis.range")
    assert axis == pytest.approx([begin, end], abs=0.02)
    assert page.evaluate("document.activeElement.className") == "plots"
    page.get_by_role("button", name="Show the whole recording").click()
    assert stretch(page) == pytest.approx(whole)


def test_events_zoom_too(open_page: OpenPage, report: Path) -> None:
    page = open_page(SMALL)
    open_report(page, report)
    line = page.locator(".lines li", has_text="document.title").first
    assert line.locator(".kind").inner_text() == "warning"
    line.get_by_role("button").click()
    begin, end = stretch(page)
    assert begin < 8.0 < end < begin + 10


def test_the_mouse_zooms_and_a_double_click_shows_the_whole(open_page: OpenPage, report: Path) -> None:
    page = open_page(DESKTOP)
    open_report(page, report)
    whole = stretch(page)
    page.evaluate("document.querySelector('.plots').scrollIntoView()")
    box = page.locator("[data-panel=stroke] .nsewdrag").bounding_box()
    assert box is not None
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.4 * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * box["width"], y, steps=4)
    page.mouse.move(box["x"] + 0.6 * box["width"], y, steps=4)
    page.mouse.up()
    until(page, "ramstroke.chapters[0].timeline.width < 0.5 * ramstroke.chapters[0].timeline.length")
    width = whole[1] - whole[0]
    assert stretch(page) == pytest.approx((whole[0] + 0.4 * width, whole[0] + 0.6 * width), abs=0.02 * width)
    page.mouse.dblclick(box["x"] + 0.5 * box["width"], y)
    until(page, "ramstroke.chapters[0].timeline.width === ramstroke.chapters[0].timeline.length")


def test_keys_zoom_move_and_step_through_the_moves(open_page: OpenPage, report: Path, moves: Any) -> None:
    page = open_page(SMALL)
    open_report(page, report)
    whole = stretch(page)
    page.locator(".plots").first.focus()
    page.keyboard.press("+")
    near = stretch(page)
    assert near[1] - near[0] == pytest.approx((whole[1] - whole[0]) / 2)
    page.keyboard.press("ArrowRight")
    assert stretch(page)[0] > near[0]
    page.keyboard.press("0")
    assert stretch(page) == pytest.approx(whole)
    for move in (moves[0], moves[1]):
        page.keyboard.press("n")
        begin, end = stretch(page)
        assert begin < move.onset_ns * 1e-9 < move.stop_ns * 1e-9 < end
    page.keyboard.press("p")
    assert stretch(page)[0] < moves[0].onset_ns * 1e-9 < stretch(page)[1] < moves[1].stop_ns * 1e-9
    # By the keyboard alone from the table into the plots.
    page.get_by_role("button", name="retract 3").focus()
    page.keyboard.press("Enter")
    assert stretch(page)[0] < moves[2].onset_ns * 1e-9 < stretch(page)[1]


def test_another_method_is_off_until_it_is_chosen(open_page: OpenPage, report: Path) -> None:
    page = open_page(SMALL)
    open_report(page, report)
    assert "clock" not in shown(page, "stroke")
    page.locator("[data-panel=stroke]").locator("xpath=..").get_by_label("clock").check()
    assert len(shown(page, "stroke")["clock"]["y"]) > 100


def test_the_label_under_the_mouse_tells_the_value(open_page: OpenPage, report: Path, settled: Any) -> None:
    page = open_page(SMALL)
    open_report(page, report)
    t_s, mm = settled
    place = int(np.argmax(mm))
    page.evaluate(f"ramstroke.chapters[0].hover({t_s[place]})")
    label = page.locator("[data-panel=stroke] .hoverlayer .legendtext").all_text_contents()
    told = next(text for text in label if text.startswith("estimate (settled)"))
    assert f"{mm[place]:.2f} ± " in told


def test_lanes_say_the_state_in_a_word(open_page: OpenPage, report: Path) -> None:
    page = open_page(SMALL)
    open_report(page, report)
    page.locator("[data-panel=lanes]").first.scroll_into_view_if_needed()
    lanes = page.locator("[data-panel=lanes]").first
    lanes.locator("svg").wait_for()
    texts = lanes.locator("text").all_text_contents()
    assert {"segment", "imu", "can", "ill", "ok"} <= set(texts)
    said = [title for title in lanes.locator("title").all_text_contents() if title.startswith("imu: ill")]
    assert said == [f"imu: ill, 4.00 s; {NASTY}"]


def test_detail_follows_the_zoom(open_page: OpenPage, report: Path) -> None:
    """Of a long record, made here in the page: every sample near, envelopes far, few points always."""
    page = open_page(SMALL)
    open_report(page, report)
    found = page.evaluate(
        """async () => {
          const { line, MOST_POINTS } = await import("report/levels.js");
          const cells = 36000, fine = Float64Array.from({ length: 600 }, (_, i) => 1000 + i * 0.01);
          const wave = (t) => Math.sin(t * 3);
          const low = Float32Array.from({ length: cells }, (_, i) => Math.min(wave(i / 10), wave(i / 10 + 0.1)));
          const high = Float32Array.from({ length: cells }, (_, i) => Math.max(wave(i / 10), wave(i / 10 + 0.1)));
          low[17777] = -9; high[23456] = 9;
          const record = { grid: { begin: 0, cell: 0.1, cells }, windows: [[1000, 1006]], fine };
          const signal = { low, high, fine: Float32Array.from(fine, wave) };
          const told = (from, until) => {
            const made = line(record, signal, from, until);
            return { n: made.x.length, low: Math.min(...made.y), high: Math.max(...made.y), fine: made.fine };
          };
          return { most: MOST_POINTS, whole: told(0, 3600), middle: told(990, 1016), near: told(1001, 1002),
                   elsewhere: told(2000, 2010) };
        }"""
    )
    assert found["whole"]["n"] <= found["most"] == 4000
    assert found["whole"]["n"] > 3000
    assert (found["whole"]["low"], found["whole"]["high"]) == (-9, 9)
    assert not found["whole"]["fine"]
    assert found["near"]["fine"]
    assert found["near"]["n"] == pytest.approx(100, abs=2)
    assert found["middle"]["n"] == pytest.approx(600 + 2 * 200, abs=8)
    assert found["elsewhere"]["n"] == 200


def test_tabs_change_the_recording(open_page: OpenPage, report: Path) -> None:
    page = open_page(SMALL)
    open_report(page, report)
    page.get_by_role("tab", name=SICK.name).click()
    assert page.locator("#chapter-0").is_hidden()
    assert page.locator("#chapter-1 h2").inner_text() == SICK.name
    page.locator("#chapter-1 .plots").scroll_into_view_if_needed()
    page.locator("#chapter-1 .plot .main-svg").first.wait_for()
    ill = shown(page, "stroke", chapter=1)["its ill readings"]
    readings = [record.reading for _, record in Recording(SICK).messages((topics.OBSERVED,))]  # type: ignore[union-attr]  # the topic holds readings
    assert len(ill["y"]) >= sum(not reading.valid for reading in readings) > 0
    page.keyboard.press("Shift+Tab")
    page.get_by_role("tab", name=SICK.name).focus()
    page.keyboard.press("ArrowLeft")
    assert page.locator("#chapter-1").is_hidden()


def test_a_finger_moves_two_fingers_zoom_and_nothing_is_wider_than_a_phone(open_page: OpenPage, report: Path) -> None:
    page = open_page(PHONE, has_touch=True, is_mobile=True)
    open_report(page, report)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE[0]
    page.evaluate("ramstroke.chapters[0].timeline.show(8, 12)")
    page.evaluate("document.querySelector('.plots').scrollIntoView()")
    _fingers(page, [[(200, 0)], [(150, 0)], [(100, 0)]])
    begin, end = stretch(page)
    assert begin > 8.5
    assert end - begin == pytest.approx(4)
    _fingers(page, [[(150, 0), (250, 0)], [(120, 0), (280, 0)], [(100, 0), (300, 0)]])
    begin, end = stretch(page)
    assert end - begin == pytest.approx(2, rel=0.1)


def _fingers(page: Page, positions: list[list[tuple[int, int]]]) -> None:
    """Pointer events as a touch screen makes them."""
    page.evaluate(
        """(positions) => {
          const plot = document.querySelector("[data-panel=stroke]");
          const y = plot.getBoundingClientRect().top + 100;
          const send = (type, id, x) => plot.dispatchEvent(new PointerEvent(type, {
            pointerType: "touch", pointerId: id, clientX: x, clientY: y, bubbles: true }));
          positions[0].forEach(([x], id) => send("pointerdown", id + 10, x));
          for (const row of positions.slice(1)) row.forEach(([x], id) => send("pointermove", id + 10, x));
          positions.at(-1).forEach(([x], id) => send("pointerup", id + 10, x));
        }""",
        positions,
    )


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_everybody_can_use_it(open_page: OpenPage, report: Path, scheme: str, size: tuple[int, int]) -> None:
    page = open_page(size, color_scheme=scheme)
    open_report(page, report)
    page.evaluate("ramstroke.chapters[0].drawAll()")
    page.evaluate("document.querySelectorAll('details').forEach((one) => (one.open = true))")
    violations = Axe().run(page).response["violations"]
    grave = [(v["id"], v["nodes"][0]["html"]) for v in violations if v["impact"] in ("serious", "critical")]
    assert grave == []


def test_it_prints_dark_on_light_with_all_plots(open_page: OpenPage, report: Path) -> None:
    page = open_page(SMALL, color_scheme="dark")
    open_report(page, report)
    page.emulate_media(media="print", color_scheme="light")
    until(page, "[...document.querySelectorAll('#chapter-0 .plot')].every((one) => one.querySelector('svg'))")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert page.locator(".toolbar").first.is_hidden()
