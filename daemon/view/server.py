"""The web server between browsers and the daemon: pages, the live WebSocket, recordings and their reports."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daemon.service.health import UNDETERMINED_SHARE
from daemon.service.live_client import SILENT_S, Line
from daemon.view import recordings
from daemon.view.browsers import Browsers, message
from daemon.view.guard import REPORT_POLICY, Guard
from daemon.view.link import DaemonLink, LinkState
from daemon.view.memory import Memory
from daemon.view.reports import Command, Reports, TooManyError, review_command

if TYPE_CHECKING:
    from aiohttp.web import Application, Request, StreamResponse

PAGES = Path(__file__).parent / "pages"
BEAT_S = 1.0
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}


class ViewServer:
    """All of one `ramstroke view`; `application` is what aiohttp serves.

    socket: of the daemon. directory: of its recordings. scratch: an empty folder for reports.
    """

    def __init__(
        self,
        socket: Path,
        directory: Path,
        scratch: Path,
        guard: Guard,
        *,
        silent_s: float = SILENT_S,
        command: Command = review_command,
    ) -> None:
        self._directory = directory.absolute()  # a report is made in another working directory
        self._guard = guard
        self._pages = {path.name: path.read_bytes() for path in PAGES.iterdir() if path.suffix in _TYPES}
        self.browsers = Browsers()
        self.memory = Memory()
        self.link = DaemonLink(socket, self._take_line, self._take_state, silent_s)
        self.reports = Reports(scratch, lambda: self.browsers.push(message("reports", self._reports())), command)

    def application(self) -> Application:
        """With the link to the daemon as its companion."""
        from aiohttp import web

        made = web.Application(client_max_size=1024)
        self._guard.install(made)
        made.add_routes(
            [
                web.get("/", self._index),
                web.get("/pages/{name}", self._page),
                web.get("/live", self._live),
                web.get("/recordings", self._recordings),
                web.get("/recordings/{name}", self._recording),
                web.post("/recordings/{name}/report", self._ask_report),
                web.get("/recordings/{name}/report", self._report),
            ]
        )
        made.cleanup_ctx.append(self._companions)
        made.on_shutdown.append(self._hang_up)
        return made

    async def _companions(self, _: Application) -> Any:
        tasks = [asyncio.ensure_future(work) for work in (self.link.run(), self._beat())]
        yield
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self.reports.close()

    async def _hang_up(self, _: Application) -> None:
        self.browsers.hang_up()

    # --- from the daemon --------------------------------------------------------------------------------------

    def _take_line(self, line: Line) -> None:
        self.memory.take(line.content)
        self.browsers.push(self._snapshot() if line.kind == "hello" else line.raw.decode().rstrip("\n"))

    def _take_state(self, _: LinkState) -> None:
        self.browsers.push(message("link", self._link()))

    async def _beat(self) -> None:
        """So that a page knows that we are there while the daemon is silent."""
        while True:
            await asyncio.sleep(BEAT_S)
            self.browsers.push(message("link", self._link()))

    def _link(self) -> dict[str, Any]:
        state = self.link.state
        return {
            "state": state.word,
            "since_s": state.since_s,
            "why": state.why,
            "now_s": time.monotonic(),
            "browsers": self.browsers.count,
            "dropped": self.browsers.dropped,
            "damaged": self.link.damaged,
        }

    def _reports(self) -> dict[str, Any]:
        return {"now_s": time.monotonic(), "reports": self.reports.rows()}

    def _snapshot(self) -> str:
        content = self.memory.snapshot() | {
            "link": self._link(),
            "reports": self._reports(),
            "undetermined_share": UNDETERMINED_SHARE,
        }
        return message("snapshot", content)

    # --- to browsers ------------------------------------------------------------------------------------------

    async def _index(self, _: Request) -> StreamResponse:
        return self._file("index.html")

    async def _page(self, request: Request) -> StreamResponse:
        return self._file(request.match_info["name"])

    def _file(self, name: str) -> StreamResponse:
        from aiohttp import web

        if name not in self._pages:
            raise web.HTTPNotFound
        return web.Response(body=self._pages[name], content_type=_TYPES[Path(name).suffix], charset="utf-8")

    async def _live(self, request: Request) -> StreamResponse:
        return await self.browsers.serve(request, self._snapshot())

    async def _recordings(self, _: Request) -> StreamResponse:
        from aiohttp import web

        rows = await asyncio.to_thread(recordings.listed, self._directory, self.memory.recording)
        return web.json_response({"recordings": rows, "directory": str(self._directory)})

    def _named(self, request: Request) -> Path:
        from aiohttp import web

        path = recordings.named(self._directory, request.match_info["name"])
        if path is None:
            raise web.HTTPNotFound(text="no recording of that name")
        return path

    async def _recording(self, request: Request) -> StreamResponse:
        from aiohttp import web

        path = self._named(request)
        disposition = {"Content-Disposition": f'attachment; filename="{path.name}"'}
        response = web.FileResponse(path, headers=disposition)
        response.content_type = "application/octet-stream"
        return response

    async def _ask_report(self, request: Request) -> StreamResponse:
        from aiohttp import web

        try:
            state = self.reports.ask(self._named(request))
        except TooManyError:
            raise web.HTTPTooManyRequests(text="other reports wait already: try again later") from None
        return web.json_response({"state": state}, status=202)

    async def _report(self, request: Request) -> StreamResponse:
        from aiohttp import web

        path = self.reports.ready(self._named(request).name)
        if path is None:
            raise web.HTTPNotFound(text="no report of this recording has been made yet")
        return web.FileResponse(path, headers={"Content-Security-Policy": REPORT_POLICY})


async def serve(
    server: ViewServer, address: str, port: int, stopping: asyncio.Event, on_listening: Callable[[], object]
) -> None:
    """Until `stopping`. Raises OSError with one sentence if it cannot listen there."""
    from aiohttp import web

    runner = web.AppRunner(server.application(), access_log=None, shutdown_timeout=1.0)
    await runner.setup()
    try:
        await web.TCPSite(runner, address, port).start()
    except (OSError, OverflowError) as error:
        await runner.cleanup()
        raise OSError(f"cannot listen on {address} port {port} ({_reason(error)}): choose another --port") from error
    try:
        on_listening()
        await stopping.wait()
    finally:
        with suppress(TimeoutError):
            await asyncio.wait_for(runner.cleanup(), 10)


def _reason(error: BaseException) -> str:
    """asyncio wraps the system's words in its own."""
    number = getattr(error, "errno", None)
    return os.strerror(number) if isinstance(number, int) and number > 0 else str(error)
