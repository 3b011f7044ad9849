"""Who may ask for what: hosts, methods, origins, the token, and the headers that every answer carries."""

from __future__ import annotations

import hmac
import ipaddress
import socket
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from aiohttp.web import Application, Request, StreamResponse

    Handler = Callable[[Request], Awaitable[StreamResponse]]

PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
# A report is one file with its own scripts: it runs apart, without this page's cookie and without any network.
REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads allow-popups; default-src 'none'; script-src 'unsafe-inline' data:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; worker-src blob:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Server": "ramstroke",
    "Content-Security-Policy": PAGE_POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_COOKIE_DAYS = 30


class Guard:
    """token: None, or what a browser must know. loopback: only names of this computer are answered to."""

    def __init__(self, token: str | None, *, loopback: bool, port: int) -> None:
        self._token = token
        self._loopback = loopback
        self._cookie = f"ramstroke_view_{port}"  # cookies are shared by all ports of a host

    def install(self, application: Application) -> None:
        """Stand before every handler of it."""
        from aiohttp import web, web_response

        # The answer to what is no HTTP at all is made out of the application's reach.
        setattr(web_response, "SERVER_SOFTWARE", "ramstroke")  # noqa: B010  # not among what it exports

        @web.middleware
        async def stand(request: Request, handler: Handler) -> StreamResponse:
            self._check_method(request)
            self._check_host(request)
            self._check_origin(request)
            fresh = self._check_token(request)
            response = await handler(request)
            if fresh and self._token is not None:
                response.set_cookie(
                    self._cookie, self._token, max_age=_COOKIE_DAYS * 86400, httponly=True, samesite="Strict", path="/"
                )
            return response

        async def add_headers(_: Request, response: StreamResponse) -> None:
            for name, value in _HEADERS.items():
                if name == "Server" or name not in response.headers:
                    response.headers[name] = value

        application.middlewares.append(stand)
        application.on_response_prepare.append(add_headers)

    def _check_method(self, request: Request) -> None:
        from aiohttp import web

        if request.method not in ("GET", "HEAD", "POST"):
            raise web.HTTPMethodNotAllowed(request.method, ("GET", "HEAD"))

    def _check_host(self, request: Request) -> None:
        """A foreign name that leads here (DNS rebinding) would make foreign pages our own."""
        from aiohttp import web

        try:
            name = urlsplit(f"//{request.headers.get('Host', '')}").hostname or ""
        except ValueError:
            name = ""
        if not is_own_name(name, loopback=self._loopback):
            raise web.HTTPMisdirectedRequest(text="this page is not served under that name")

    def _check_origin(self, request: Request) -> None:
        """Foreign pages may neither listen on the WebSocket nor start anything."""
        from aiohttp import web

        origin = request.headers.get("Origin")
        if origin is None and request.method != "POST":
            return  # no browser, or one that asks for its own page
        if origin is None or not same_place(origin, request.headers.get("Host", "")):
            raise web.HTTPForbidden(text="asked by a page of another place")

    def _check_token(self, request: Request) -> bool:
        """Whether it came anew, in the address. Raises HTTPUnauthorized."""
        from aiohttp import web

        if self._token is None:
            return False
        if request.path == "/" and _equal(request.query.get("token", ""), self._token):
            return True
        if _equal(request.cookies.get(self._cookie, ""), self._token):
            return False
        raise web.HTTPUnauthorized(
            text="Open the address that `ramstroke view` printed when it was started, with its token.\n"
            "请使用 ramstroke view 启动时显示的完整网址（含令牌）打开。\n"
        )


def is_loopback(address: str) -> bool:
    """Whether an address to listen on is this computer's own."""
    if address == "localhost":
        return True
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def is_own_name(name: str, *, loopback: bool) -> bool:
    """Numbers cannot be rebound; of names only our own."""
    if is_loopback(name):
        return True
    if loopback:
        return False
    try:
        ipaddress.ip_address(name)
    except ValueError:
        own = socket.gethostname().lower()
        return name.lower() in (own, own.partition(".")[0], f"{own}.local")
    return True


def same_place(origin: str, host: str) -> bool:
    """Whether an Origin header names the server that a Host header names."""
    parts = urlsplit(origin)
    return parts.scheme in ("http", "https") and parts.netloc.lower() == host.lower() != ""


def _equal(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(errors="backslashreplace"), token.encode())
