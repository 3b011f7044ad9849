"""Opens a report and looks at it, for tests and for the picture in the documentation.

As a program: python -m tests.browser.report_pages REPORT.html PICTURE.png
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from playwright.sync_api import Page

# What a plot shows now: the traces that were handed to the library, times in seconds of the record.
_SHOWN = """([chapter, key]) => {
  const figure = ramstroke.chapters[chapter].figures.find((one) => one.panel.key === key);
  return (figure.traces ?? []).map((trace) => ({
    name: trace.name,
    t: Array.from(trace.x, (x) => figure.second(x)),
    y: Array.from(trace.y, (y) => (Number.isNaN(y) ? null : y)),
  }));
}"""


def until(page: Page, expression: str) -> None:
    """Wait for it to be true; the page's policy forbids the library's own way."""
    for _ in range(600):
        if page.evaluate(expression):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"still not: {expression}")


def open_report(page: Page, report: Path) -> None:
    """Wait until its first plot is drawn."""
    page.goto(report.as_uri())
    until(page, "globalThis.ramstroke !== undefined")
    page.locator(".plots").first.scroll_into_view_if_needed()
    page.locator(".plot .main-svg").first.wait_for()


def shown(page: Page, key: str, chapter: int = 0) -> dict[str, dict[str, list[Any]]]:
    """The traces of a plot by name."""
    traces: list[dict[str, Any]] = page.evaluate(_SHOWN, [chapter, key])
    return {trace["name"]: trace for trace in traces}


def stretch(page: Page, chapter: int = 0) -> tuple[float, float]:
    """What the plots show, in seconds of the record."""
    timeline = f"ramstroke.chapters[{chapter}].timeline"
    begin, end = page.evaluate(f"[{timeline}.from, {timeline}.until]")
    return begin, end


def shoot_report(page: Page, report: Path, picture: Path) -> None:
    """The first move, from the head of the page to the states."""
    open_report(page, report)
    page.evaluate("ramstroke.chapters[0].drawAll()")
    page.evaluate("scrollTo(0, 0)")
    page.wait_for_timeout(300)
    page.screenshot(path=picture, clip={"x": 0, "y": 0, "width": 1366, "height": 1950}, full_page=True)


def main() -> None:
    """Make the picture."""
    import shutil

    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1366, "height": 768})
        shoot_report(page, Path(sys.argv[1]).resolve(), Path(sys.argv[2]))
        browser.close()


if __name__ == "__main__":
    main()
