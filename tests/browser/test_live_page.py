"""The live page in a browser: what it shows is what the daemon said, it never shows old numbers as if they lived."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, WebSocketRoute, expect

from daemon.service.health import _BY_STATE, UNDETERMINED_SHARE
from drivers.adis16448.quality import WORDS
from estimation.recognition.motion import Decision
from estimation.records import CanState, MoveKind
from tests.browser.conftest import DESKTOP, PHONE, SMALL, OpenPage
from tests.conftest import DemoRun
from tests.daemon.view.view_kit import (
    FakeDaemon,
    RunningView,
    daemon_at,
    estimate,
    move,
    part,
    report_command,
    status,
    viewing,
)

WRITES = (
    "import sys, pathlib;"
    "pathlib.Path(sys.argv[2]).write_text('<h1>report</h1><script>document.title = \"run\"</script>')"
)


@pytest.fixture
def daemon(short_path: Path) -> Iterator[FakeDaemon]:
    with daemon_at(short_path / "live") as made:
        made.moves = [move("retract", 0.3), move("push", 499.6)]
        made.events = [{"t_s": time.monotonic() - 40, "what": "start confirmed (push)"}]
        made.start()
        yield made


@pytest.fixture
def view(daemon: FakeDaemon, short_path: Path) -> Iterator[RunningView]:
    with viewing(short_path, command=report_command(WRITES)) as running:
        yield running


def opened(open_page: OpenPage, view: RunningView, size: tuple[int, int] = SMALL, **options: Any) -> Page:
    page = open_page(size, **options)
    page.goto(view.url)
    expect(page.locator("body")).to_have_attribute("data-freshness", "fresh")
    return page


def lamp(page: Page, name: str) -> Any:
    return page.locator(f'.lamp[data-part="{name}"]')


# --- what is shown --------------------------------------------------------------------------------------------


def test_the_numbers_are_those_of_the_socket(open_page: OpenPage, daemon: FakeDaemon, view: RunningView) -> None:
    page = opened(open_page, view)
    for stroke_mm, sigma_mm, shown, sigma, band in [
        (327.449, 1.24, "327.4", "1.2", "2.4"),
        (-0.04, 0.6, "0.0", "0.6", "1.2"),
        (-3.26, 25.0, "−3.3", "25", "49"),
    ]:
        daemon.row = lambda stroke_mm=stroke_mm, sigma_mm=sigma_mm: estimate(stroke_mm, sigma_mm=sigma_mm)  # type: ignore[misc]  # bound now
        expect(page.locator("#stroke-number")).to_have_text(shown)
        expect(page.locator("#stroke-sigma")).to_have_text(f"± {sigma} mm (1σ) · ± {band} mm (95 %)")


@pytest.mark.parametrize(
    ("segment", "velocity", "words"),
    [
        ("ZUPT", 0.0, "At rest"),
        ("CVS", 14.5, "Pushing · steady speed"),
        ("CVS", -35.0, "Retracting · steady speed"),
        ("VVS", 8.0, "Pushing · speed changing"),
        ("VVS", 0.1, "Moving · speed changing"),
        ("CVS", 0.3, "Moving · steady speed"),
    ],
)
def test_the_segment_is_said_in_words(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView, segment: str, velocity: float, words: str
) -> None:
    daemon.row = lambda: estimate(segment=segment, velocity_mm_s=velocity)
    expect(opened(open_page, view).locator("#segment")).to_have_text(words)


def test_a_stroke_that_is_not_known_is_not_shown_as_a_number(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView
) -> None:
    page = opened(open_page, view)
    number = page.locator("#stroke-number")
    daemon.row = lambda: estimate(250.0, sigma_mm=UNDETERMINED_SHARE * 500 - 0.1)
    expect(number).to_have_text("250.0")
    daemon.row = lambda: estimate(250.0, sigma_mm=UNDETERMINED_SHARE * 500 + 0.1)
    expect(number).to_have_text("undetermined")
    expect(page.locator("#stroke-unit")).to_be_hidden()
    expect(page.locator("#stroke-sigma")).to_contain_text("anywhere between the stops (± 140 mm")
    expect(page.locator(".ram-rod")).to_have_css("visibility", "hidden")


def test_the_ram_is_drawn_to_scale(open_page: OpenPage, daemon: FakeDaemon, view: RunningView) -> None:
    page = opened(open_page, view)
    widths = []
    for stroke_mm in (100.0, 400.0):
        daemon.row = lambda stroke_mm=stroke_mm: estimate(stroke_mm)  # type: ignore[misc]  # bound now
        expect(page.locator("#stroke-number")).to_have_text(f"{stroke_mm:.1f}")
        widths.append(float(page.locator(".ram-rod").get_attribute("width") or 0))
    assert widths[1] == pytest.approx(4 * widths[0])


def test_a_sick_part_is_told_with_word_time_reason_and_advice(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView
) -> None:
    condition = _BY_STATE[CanState.STUCK]
    sick = part("ill", condition.what, condition.advice)
    daemon.status = status(displacement=sick, can=part("waiting", "can0 is missing", "plug it in"), jy901=part("off"))
    daemon.row = lambda: estimate(can_state="stuck")
    page = opened(open_page, view)
    since_ms = (time.time() - (time.monotonic() - sick["since_s"])) * 1e3
    wanted = page.evaluate("ms => [0, 999].map(e => new Date(ms + e).toLocaleTimeString('en-GB'))", since_ms - 500)
    shown = lamp(page, "displacement")
    expect(shown).to_contain_text(condition.what)
    expect(shown).to_contain_text(condition.advice)
    assert shown.locator(".state").inner_text() in [f"stuck since {clock}" for clock in wanted]
    expect(lamp(page, "can").locator(".state")).to_contain_text("does not work since")
    expect(lamp(page, "imu").locator(".state")).to_have_text("ok")
    expect(lamp(page, "jy901")).to_have_count(0)
    shapes = {name: lamp(page, name).locator("svg").inner_html() for name in ("displacement", "can", "imu")}
    assert len(set(shapes.values())) == 3  # told apart without colour


def test_what_did_not_reach_the_page_is_told(open_page: OpenPage, daemon: FakeDaemon, view: RunningView) -> None:
    page = opened(open_page, view)
    expect(page.locator("#looking")).to_have_text("Browsers: 1 · viewers of the daemon: 1")
    daemon.push("dropped", {"lines": 7})
    view.server.link._link.damaged = 2
    expect(page.locator("#looking")).to_contain_text("messages that did not reach this page: 9")


def test_moves_and_events_of_before_and_new_ones_are_listed_newest_first(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView
) -> None:
    page = opened(open_page, view, DESKTOP)
    rows = page.locator("#move-rows tr")
    expect(rows).to_have_count(2)
    expect(rows.first).to_contain_text("0.4 → 499.6")
    daemon.push("move", move("retract", 1.7))
    daemon.push("event", {"t_s": time.monotonic(), "what": "gap of 0.052 s in the inertial samples"})
    expect(rows).to_have_count(3)
    expect(rows.first).to_contain_text("0.4 → 1.7")
    expect(page.locator("#event-rows li").first).to_contain_text("gap of 0.052 s")
    expect(page.locator("#event-rows li").last).to_contain_text("start confirmed (push)")


def test_the_plots_show_the_past_move_on_and_can_be_stopped(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView
) -> None:
    page = opened(open_page, view)
    canvas = page.locator("#plot-stroke")

    def picture() -> Any:
        return canvas.evaluate("c => c.toDataURL()")

    def changes() -> bool:
        before = picture()
        page.wait_for_timeout(600)
        return bool(picture() != before)

    assert changes()
    page.get_by_role("button", name="Pause").click()
    page.wait_for_timeout(200)
    assert not changes()
    canvas.hover()
    expect(page.locator("#readout")).to_contain_text("123.4 ± 1.5 mm, 14.5 mm/s")
    page.get_by_role("button", name="Go on").click()
    assert changes()


# --- old numbers ----------------------------------------------------------------------------------------------


def test_a_daemon_that_ends_and_comes_back_is_told_without_a_reload(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView
) -> None:
    page = opened(open_page, view)
    page.evaluate("window.sameDocument = true")
    banner, body = page.locator("#banner"), page.locator("body")
    expect(banner).to_have_text("")
    daemon.stop()
    expect(banner).to_contain_text(
        re.compile(r"The daemon has been gone since \d\d:\d\d:\d\d\. What is shown is old\.")
    )
    expect(body).to_have_class("stale")
    expect(page.locator("#stale-mark")).to_have_text(re.compile(r"old, from \d\d:\d\d:\d\d"))
    expect(page.locator("#stroke-number")).to_have_text("123.4")
    expect(page.locator("#stroke-number")).to_have_css("text-decoration-line", "line-through")
    assert page.title() == "ramstroke"
    daemon.row = lambda: estimate(222.2)
    daemon.start()
    expect(banner).to_have_text("")
    expect(body).not_to_have_class("stale")
    expect(page.locator("#stroke-number")).to_have_text("222.2")
    expect(page.locator("#stale-mark")).to_be_hidden()
    assert page.evaluate("window.sameDocument") is True


def test_a_daemon_that_is_silent_is_told(open_page: OpenPage, daemon: FakeDaemon, view: RunningView) -> None:
    page = opened(open_page, view)
    daemon.fall_silent()
    expect(page.locator("#banner")).to_contain_text("The daemon has been silent since", timeout=8000)
    expect(page.locator("body")).to_have_class("stale")
    daemon.speak_again()
    expect(page.locator("#banner")).to_have_text("")


def test_estimates_that_cease_while_the_daemon_speaks_are_told(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView
) -> None:
    page = opened(open_page, view)
    daemon.fall_silent()
    for _ in range(12):
        daemon.push("status", daemon.status)
        page.wait_for_timeout(400)
    expect(page.locator("#banner")).to_contain_text("No estimate has come since")
    expect(page.locator("body")).to_have_class("stale")


def test_a_page_without_its_server_says_so_and_finds_it_again(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView
) -> None:
    """The connection is cut and comes back within the browser: a refused one would be an error of its console."""
    page = open_page(SMALL)
    routes: list[WebSocketRoute] = []
    reachable = True

    def route(found: WebSocketRoute) -> None:
        if reachable:
            routes.append(found)
            found.connect_to_server()
        else:
            found.close()

    page.route_web_socket("**/live", route)
    page.goto(view.url)
    expect(page.locator("body")).to_have_attribute("data-freshness", "fresh")
    reachable = False
    routes[0].close()
    expect(page.locator("#banner")).to_contain_text("This page has lost its server (ramstroke view) since")
    expect(page.locator("body")).to_have_class("stale")
    page.wait_for_timeout(1500)
    assert page.locator("#banner").inner_text().count("since") == 1
    reachable = True
    expect(page.locator("#banner")).to_have_text("", timeout=15_000)
    expect(page.locator("body")).to_have_attribute("data-freshness", "fresh")


def test_a_network_that_goes_mute_without_closing_is_noticed(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView
) -> None:
    page = open_page(SMALL)
    mute = False

    def route(found: WebSocketRoute) -> None:
        server = found.connect_to_server()
        server.on_message(lambda message: None if mute else found.send(message))

    page.route_web_socket("**/live", route)
    page.goto(view.url)
    expect(page.locator("body")).to_have_attribute("data-freshness", "fresh")
    mute = True
    expect(page.locator("#banner")).to_contain_text("This page has lost its server", timeout=8000)
    mute = False
    expect(page.locator("#banner")).to_have_text("", timeout=15_000)


# --- who looks, and how ---------------------------------------------------------------------------------------


def test_several_pages_show_the_same(open_page: OpenPage, daemon: FakeDaemon, view: RunningView) -> None:
    pages = [opened(open_page, view, size) for size in (DESKTOP, SMALL, PHONE)]
    daemon.row = lambda: estimate(444.4)
    for page in pages:
        expect(page.locator("#stroke-number")).to_have_text("444.4")
        expect(page.locator("#looking")).to_contain_text("Browsers: 3")


@pytest.mark.parametrize("size", [DESKTOP, SMALL, PHONE])
def test_nothing_is_wider_than_the_screen(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView, short_path: Path, size: tuple[int, int]
) -> None:
    (short_path / "recordings" / "ramstroke-20261128T052901Z-12.mcap").write_bytes(b"x")
    daemon.status = status(
        imu=part(
            "ill", "samples are missed: reads come too late", max((advice for _, advice in WORDS.values()), key=len)
        )
    )
    for language in ("en-GB", "zh-CN"):
        page = opened(open_page, view, size, locale=language)
        expect(page.locator("#recording-rows tr")).to_have_count(1)
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]


def test_all_that_matters_is_above_the_fold(open_page: OpenPage, view: RunningView) -> None:
    page = opened(open_page, view, SMALL)
    for what in ("#stroke", "#parts", "#plots"):
        box = page.locator(what).bounding_box()
        assert box is not None
        assert box["y"] + box["height"] <= SMALL[1]
    phone = opened(open_page, view, PHONE)
    for what in ("#stroke", '.lamp[data-part="recorder"]'):
        box = phone.locator(what).bounding_box()
        assert box is not None
        assert box["y"] + box["height"] <= PHONE[1]


def test_everything_can_be_reached_and_used_by_keyboard(
    open_page: OpenPage, view: RunningView, short_path: Path
) -> None:
    (short_path / "recordings" / "a.mcap").write_bytes(b"x")
    page = opened(open_page, view)
    expect(page.locator("#recording-rows tr")).to_have_count(1)
    reached = []
    for _ in range(30):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement === document.body"):
            break
        reached.append(page.evaluate("document.activeElement.innerText.trim().split('\\n')[0]"))
        outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
        assert outline != "none"
    for words in ("English", "中文", "Pause", "a.mcap", "Make report"):
        assert words in reached
    page.locator("#pause").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#pause")).to_have_attribute("aria-pressed", "true")


def test_a_report_is_made_on_demand_and_runs_caged(open_page: OpenPage, view: RunningView, short_path: Path) -> None:
    (short_path / "recordings" / "a.mcap").write_bytes(b"x")
    page = opened(open_page, view)
    page.get_by_role("button", name="Make a report of a.mcap").click()
    link = page.get_by_role("link", name="Open the report of a.mcap")
    expect(link).to_be_visible()
    with page.context.expect_page() as popup:
        link.click()
    expect(popup.value.locator("h1")).to_have_text("report")
    assert popup.value.title() == "run"  # its scripts run
    assert popup.value.evaluate("origin") == "null"  # apart from the page


def test_the_report_of_review_works_in_that_cage(
    open_page: OpenPage, daemon: FakeDaemon, short_path: Path, demo_run: DemoRun
) -> None:
    with viewing(short_path) as view:
        (short_path / "recordings" / "a.mcap").write_bytes(demo_run.recording.read_bytes())
        page = opened(open_page, view)
        page.get_by_role("button", name="Make a report of a.mcap").click()
        link = page.get_by_role("link", name="Open the report of a.mcap")
        expect(link).to_be_visible(timeout=120_000)
        with page.context.expect_page() as popup:
            link.click()
        report = popup.value
        report.locator(".plots").first.scroll_into_view_if_needed()
        expect(report.locator(".plot .main-svg").first).to_be_visible(timeout=30_000)


def test_the_language_is_the_browsers_until_one_is_chosen_and_then_remembered(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView
) -> None:
    condition = _BY_STATE[CanState.STUCK]
    daemon.status = status(displacement=part("ill", condition.what, condition.advice))
    daemon.row = lambda: estimate(can_state="stuck")
    page = opened(open_page, view, locale="zh-CN")
    expect(page.locator("html")).to_have_attribute("lang", "zh-CN")
    expect(page.locator("#segment")).to_have_text("推溜 · 匀速")
    expect(page.locator("#stroke-title")).to_have_text("推移行程")
    expect(lamp(page, "displacement")).to_contain_text("位移传感器")
    expect(lamp(page, "displacement")).to_contain_text("千斤顶在动作，位移读数却不变")
    page.get_by_role("button", name="English").click()
    expect(page.locator("#segment")).to_have_text("Pushing · steady speed")
    page.reload()
    expect(page.locator("#stroke-title")).to_have_text("Stroke")
    expect(page.get_by_role("button", name="English")).to_have_attribute("aria-pressed", "true")


def test_both_languages_say_everything(open_page: OpenPage, view: RunningView) -> None:
    page = opened(open_page, view)
    texts = page.evaluate("import('/pages/texts.js').then(m => m.TEXTS)")
    assert texts["en"].keys() == texts["zh"].keys()
    for name, words in texts["en"].items():
        assert set(re.findall(r"\{\w+\}", words)) == set(re.findall(r"\{\w+\}", texts["zh"][name])), name
    used = set(re.findall(r'data-(?:text|label)="(\w+)"', page.content()))
    assert used <= texts["en"].keys()


def test_the_daemons_own_sentences_have_chinese_ones(open_page: OpenPage, view: RunningView) -> None:
    sentences = [words for condition in _BY_STATE.values() for words in (condition.what, condition.advice)]
    sentences += [words for pair in WORDS.values() for words in pair]
    sentences += [f"{decision} ({kind})" for decision in Decision for kind in MoveKind]
    page = opened(open_page, view)
    told = page.evaluate("all => import('/pages/sentences.js').then(m => all.map(s => m.told(s, 'zh')))", sentences)
    untranslated = [s for s, t in zip(sentences, told, strict=True) if not re.search(r"[\u4e00-\u9fff]", t)]
    assert untranslated == []


def test_running_numbers_are_not_read_aloud_but_changes_of_the_state_are(
    open_page: OpenPage, daemon: FakeDaemon, view: RunningView
) -> None:
    page = opened(open_page, view)
    assert page.locator("#stroke [aria-live], #stroke [role=status], #stroke [role=alert]").count() == 0
    page.evaluate(
        "window.said = []; new MutationObserver(() => said.push(document.getElementById('announcement').textContent))"
        ".observe(document.getElementById('announcement'), {childList: true, characterData: true, subtree: true})"
    )
    page.wait_for_timeout(1500)
    assert page.evaluate("said") == []
    daemon.status = status(can=part("ill", "no acknowledgement on can0: no other node confirms a frame", "check"))
    daemon.push("move", move("push", 480.0))
    expect(page.locator("#announcement")).to_contain_text("CAN bus: ill")
    assert "push finished at 480.0 mm" in " ".join(page.evaluate("said"))


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [SMALL, PHONE])
@pytest.mark.parametrize("state", ["fresh", "stale"])
def test_axe_finds_nothing_serious(
    open_page: OpenPage,
    daemon: FakeDaemon,
    view: RunningView,
    short_path: Path,
    scheme: str,
    size: tuple[int, int],
    state: str,
) -> None:
    (short_path / "recordings" / "a.mcap").write_bytes(b"x")
    daemon.status = status(can=part("ill", "what", "advice"), imu=part("waiting", "what", "advice"), loop=part("off"))
    page = opened(open_page, view, size, color_scheme=scheme)
    expect(page.locator("#recording-rows tr")).to_have_count(1)
    if state == "stale":
        daemon.stop()
        expect(page.locator("body")).to_have_class("stale")
    found = Axe().run(page).response["violations"]
    grave = [(v["id"], [n["html"] for n in v["nodes"]]) for v in found if v["impact"] in ("serious", "critical")]
    assert grave == []
