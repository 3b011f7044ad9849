"""The browser of the tests works."""

from __future__ import annotations

from tests.browser.conftest import DESKTOP, OpenPage


def test_a_page_is_shown(open_page: OpenPage) -> None:
    page = open_page(DESKTOP)
    page.set_content("<h1>推移 stroke</h1>")
    assert page.inner_text("h1") == "推移 stroke"
