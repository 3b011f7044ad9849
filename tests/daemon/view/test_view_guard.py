"""Who may ask for what: each way in that must be shut is tried."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path

import pytest

from daemon.view.guard import is_loopback, is_own_name, same_place
from tests.daemon.view.view_kit import RunningView, viewing

TOKEN = "abcdefghijklmnop0123456789"
EVERY_PATH = ("/", "/pages/main.js", "/recordings", "/recordings/a.mcap", "/recordings/a.mcap/report", "/nothing")
UPGRADE = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
}


@dataclass
class Answer:
    status: int
    headers: dict[str, str]
    body: bytes


def ask(view: RunningView, path: str = "/", method: str = "GET", **headers: str) -> Answer:
    """Headers exactly as given, underscores as hyphens; the Host is the right one unless given."""
    named = {"Host": f"127.0.0.1:{view.port}"} | {name.replace("_", "-"): value for name, value in headers.items()}
    with closing(HTTPConnection("127.0.0.1", view.port, timeout=10)) as connection:
        connection.putrequest(method, path, skip_host=True)
        for name, value in named.items():
            connection.putheader(name, value)
        connection.endheaders()
        response = connection.getresponse()
        body = b"" if response.status == 101 else response.read()
        return Answer(response.status, {name.lower(): value for name, value in response.getheaders()}, body)


@pytest.fixture
def view(short_path: Path) -> Iterator[RunningView]:
    with viewing(short_path) as running:
        (short_path / "recordings" / "a.mcap").write_bytes(b"recording")
        yield running


@pytest.fixture
def locked(short_path: Path) -> Iterator[RunningView]:
    with viewing(short_path, TOKEN, loopback=False) as running:
        (short_path / "recordings" / "a.mcap").write_bytes(b"recording")
        yield running


# --- names (DNS rebinding) ------------------------------------------------------------------------------------


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost:9000", "[::1]:8448", "LOCALHOST"])
def test_a_name_of_this_computer_is_answered_to(view: RunningView, host: str) -> None:
    assert ask(view, Host=host).status == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example", "192.168.1.5", "", "["]
)
def test_any_other_name_is_refused(view: RunningView, host: str) -> None:
    answers = [ask(view, path, Host=host) for path in EVERY_PATH] + [ask(view, "/live", Host=host, **UPGRADE)]
    assert {answer.status for answer in answers} == {421}


def test_beyond_loopback_numbers_and_the_own_name_are_answered_to() -> None:
    assert all(is_own_name(name, loopback=False) for name in ("10.1.2.3", "fe80::1", socket.gethostname(), "localhost"))
    assert not any(is_own_name(name, loopback=False) for name in ("evil.example", ""))
    assert [is_loopback(a) for a in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "::", "10.0.0.1")] == [True] * 3 + [
        False
    ] * 3


# --- origins (pages of other places) --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1.evil.example"]
)
def test_a_websocket_of_a_foreign_page_is_refused(view: RunningView, origin: str) -> None:
    assert ask(view, "/live", Origin=origin, **UPGRADE).status == 403


def test_a_websocket_of_the_own_page_is_opened(view: RunningView) -> None:
    assert ask(view, "/live", Origin=view.url, **UPGRADE).status == 101


def test_a_report_is_begun_by_the_own_page_only(view: RunningView) -> None:
    path = "/recordings/a.mcap/report"
    assert ask(view, path, "POST").status == 403
    assert ask(view, path, "POST", Origin="http://evil.example").status == 403
    assert view.server.reports.rows() == {}
    assert ask(view, path, "POST", Origin=view.url).status == 202
    assert list(view.server.reports.rows()) == ["a.mcap"]


def test_an_origin_is_compared_whole() -> None:
    assert same_place("http://a:1", "A:1")
    assert not any(
        same_place(origin, host)
        for origin, host in [("http://a:1", "a:2"), ("file://", ""), ("ftp://a:1", "a:1"), ("http://a:1@b", "a:1")]
    )


# --- methods --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "PROPFIND"])
def test_other_methods_are_refused_everywhere(view: RunningView, method: str) -> None:
    assert {ask(view, path, method, Origin=view.url).status for path in (*EVERY_PATH, "/live")} == {405}


def test_only_reports_take_a_post(view: RunningView) -> None:
    paths = ("/", "/pages/main.js", "/recordings", "/recordings/a.mcap", "/live")
    assert {ask(view, path, "POST", Origin=view.url).status for path in paths} == {405}


@pytest.mark.parametrize("path", ["/", "/pages/main.js", "/recordings", "/recordings/a.mcap"])
def test_head_answers_as_get_without_the_body(view: RunningView, path: str) -> None:
    got, head = ask(view, path), ask(view, path, "HEAD")
    assert (head.status, head.body) == (200, b"")
    assert head.headers["content-type"] == got.headers["content-type"]
    assert got.body


# --- headers --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", EVERY_PATH)
def test_every_answer_carries_its_guards(view: RunningView, path: str) -> None:
    headers = ask(view, path).headers
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'self'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cache-control"] == "no-store"
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["cross-origin-resource-policy"] == "same-origin"
    assert headers["server"] == "ramstroke"
    assert "access-control-allow-origin" not in headers


def test_an_answer_to_no_http_at_all_tells_no_versions(view: RunningView) -> None:
    with socket.create_connection(("127.0.0.1", view.port), timeout=10) as channel:
        channel.sendall(b"\x16\x03\x01 nonsense\r\n\r\n")
        answer = channel.recv(65536)
    assert answer.startswith(b"HTTP/1.")
    assert b" 400 " in answer
    assert b"aiohttp" not in answer.lower()
    assert b"python" not in answer.lower()


def test_the_page_has_no_script_or_style_of_its_own_in_the_markup(view: RunningView) -> None:
    page = ask(view).body.decode()
    assert "<script>" not in page
    assert "style=" not in page
    assert " on" not in page.replace(" on the", "")
    assert "http:" not in page
    assert "https:" not in page


# --- files ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        "../secret.mcap",
        "..%2fsecret.mcap",
        "%2e%2e%2fsecret.mcap",
        "..%5csecret.mcap",
        "%2fetc%2fpasswd",
        "link.mcap",
        "folder.mcap",
        ".hidden.mcap",
        "other.txt",
        "a.mcap%00",
        "a.mcap%0a",
        "pipe.mcap",
    ],
)
def test_only_listed_recordings_are_handed_out(view: RunningView, name: str) -> None:
    import os

    folder = view.folder / "recordings"
    (view.folder / "secret.mcap").write_bytes(b"secret")
    (folder / "link.mcap").symlink_to(view.folder / "secret.mcap")
    (folder / "folder.mcap").mkdir()
    (folder / ".hidden.mcap").write_bytes(b"secret")
    (folder / "other.txt").write_bytes(b"secret")
    os.mkfifo(folder / "pipe.mcap")
    for path in (f"/recordings/{name}", f"/recordings/{name}/report"):
        answer = ask(view, path)
        assert answer.status == 404
        assert b"secret" not in answer.body
    assert ask(view, f"/recordings/{name}/report", "POST", Origin=view.url).status in (404, 405)
    assert b"a.mcap" in ask(view, "/recordings").body
    assert name.encode() not in ask(view, "/recordings").body


@pytest.mark.parametrize("name", ["..%2fserver.py", "../server.py", "%2e%2e/server.py", "", "main.py", "index.html%00"])
def test_only_the_pages_own_files_are_handed_out(view: RunningView, name: str) -> None:
    assert ask(view, f"/pages/{name}").status == 404


# --- the token ------------------------------------------------------------------------------------------------


def test_without_the_token_nothing_is_told(locked: RunningView) -> None:
    answers = [ask(locked, path) for path in EVERY_PATH] + [ask(locked, "/live", Origin=locked.url, **UPGRADE)]
    answers += [ask(locked, "/recordings/a.mcap/report", "POST", Origin=locked.url)]
    assert {answer.status for answer in answers} == {401}
    assert not any(b"recording" in answer.body or TOKEN.encode() in answer.body for answer in answers)


@pytest.mark.parametrize("token", ["", "x", TOKEN[:-1], TOKEN + "x", TOKEN.upper(), "é"])
def test_a_wrong_token_opens_nothing(locked: RunningView, token: str) -> None:
    from urllib.parse import quote

    answer = ask(locked, f"/?token={quote(token)}")
    assert answer.status == 401
    assert "set-cookie" not in answer.headers
    assert ask(locked, Cookie=f"ramstroke_view_{locked.port}={quote(token)}").status == 401


def test_bytes_that_are_no_text_are_no_token(locked: RunningView) -> None:
    with socket.create_connection(("127.0.0.1", locked.port), timeout=10) as channel:
        host = f"Host: 127.0.0.1:{locked.port}".encode()
        cookie = f"Cookie: ramstroke_view_{locked.port}=".encode() + b"\xff\xfe"
        channel.sendall(b"GET / HTTP/1.1\r\n" + host + b"\r\n" + cookie + b"\r\n\r\n")
        assert channel.recv(65536).split()[1] in (b"400", b"401")


def test_the_token_in_the_address_is_kept_in_a_cookie_that_scripts_and_other_sites_do_not_get(
    locked: RunningView,
) -> None:
    answer = ask(locked, f"/?token={TOKEN}")
    assert answer.status == 200
    cookie, *attributes = (words.strip() for words in answer.headers["set-cookie"].split(";"))
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(attributes)
    for path in ("/", "/pages/main.js", "/recordings", "/recordings/a.mcap"):
        assert ask(locked, path, Cookie=cookie).status == 200
    assert ask(locked, "/live", Cookie=cookie, Origin=locked.url, **UPGRADE).status == 101
    assert ask(locked, "/live", Cookie=cookie, Origin="http://evil.example", **UPGRADE).status == 403
    assert ask(locked, f"/recordings?token={TOKEN}").status == 401  # only the page takes it from an address
