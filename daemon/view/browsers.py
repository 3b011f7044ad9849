"""Browsers on their WebSockets. One that reads too slowly loses its oldest messages, is told, and disturbs nobody."""

from __future__ import annotations

import asyncio
import json
import socket
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from aiohttp.web import Request, WebSocketResponse

BROWSERS = 16
MESSAGES_PER_BROWSER = 100
LARGEST_INCOMING = 1024  # a browser has nothing to say
BUFFER_BYTES = 64 * 1024  # in our process
KERNEL_BYTES = 256 * 1024  # with much less, acknowledgements on this computer's own network come late
HEARTBEAT_S = 20.0  # a browser that does not answer within half of it is gone
TRY_AGAIN_LATER = 1013


def message(kind: str, content: dict[str, Any]) -> str:
    """As it goes to browsers."""
    return json.dumps({"type": kind} | content, allow_nan=False, separators=(",", ":"))


class _Browser:
    def __init__(self, channel: WebSocketResponse, transport: asyncio.WriteTransport) -> None:
        self._channel = channel
        self._transport = transport
        self._messages: deque[str] = deque(maxlen=MESSAGES_PER_BROWSER)
        self._wake = asyncio.Event()
        self.dropped = 0

    def push(self, text: str) -> None:
        self.dropped += len(self._messages) == MESSAGES_PER_BROWSER
        self._messages.append(text)
        self._wake.set()

    async def serve(self) -> None:
        """Send until cancelled or the browser has gone."""
        told = 0
        with suppress(OSError, RuntimeError):
            while True:
                await self._wake.wait()
                self._wake.clear()
                while self._messages:
                    if self.dropped != told:
                        told = self.dropped
                        await self._channel.send_str(message("dropped", {"messages": told}))
                    await self._channel.send_str(self._messages.popleft())

    def hang_up(self) -> None:
        self._transport.abort()  # `close` would wait for a browser that does not read


class Browsers:
    """All that look; `push` never waits."""

    def __init__(self) -> None:
        self._browsers: set[_Browser] = set()
        self._dropped_before = 0
        self.refused = 0

    @property
    def count(self) -> int:
        """How many look."""
        return len(self._browsers)

    @property
    def dropped(self) -> int:
        """Messages that slow browsers lost."""
        return self._dropped_before + sum(browser.dropped for browser in self._browsers)

    def push(self, text: str) -> None:
        """One message to every browser."""
        for browser in self._browsers:
            browser.push(text)

    async def serve(self, request: Request, first: str) -> WebSocketResponse:
        """One browser, from its coming with the message `first` until it goes."""
        from aiohttp import web

        channel = web.WebSocketResponse(
            max_msg_size=LARGEST_INCOMING + 1, heartbeat=HEARTBEAT_S, compress=False, writer_limit=BUFFER_BYTES
        )
        await channel.prepare(request)
        if self.count >= BROWSERS:
            self.refused += 1
            await channel.send_str(message("refused", {"browsers": BROWSERS}))
            await channel.close(code=TRY_AGAIN_LATER)
            return channel
        browser = _Browser(channel, _bounded(request))
        browser.push(first)
        self._browsers.add(browser)
        sending = asyncio.ensure_future(browser.serve())
        try:
            async for _ in channel:
                pass  # what it says is thrown away; its end is noticed here
        finally:
            sending.cancel()
            self._browsers.discard(browser)
            self._dropped_before += browser.dropped
        return channel

    def hang_up(self) -> None:
        """On everybody, those too that do not read."""
        for browser in self._browsers:
            browser.hang_up()


def _bounded(request: Request) -> asyncio.WriteTransport:
    """Its connection; what the kernel keeps for a browser that does not read is old before it is read."""
    transport = request.transport
    assert isinstance(transport, asyncio.WriteTransport)
    transport.set_write_buffer_limits(high=BUFFER_BYTES)
    transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, KERNEL_BYTES)
    return transport
