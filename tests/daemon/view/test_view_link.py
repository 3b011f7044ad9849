"""What goes from the daemon's socket to browsers: snapshot, lines, news of the link; all of it bounded."""

from __future__ import annotations

import asyncio
import json
import socket
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from daemon.view.browsers import BROWSERS, BUFFER_BYTES, KERNEL_BYTES, LARGEST_INCOMING, MESSAGES_PER_BROWSER
from daemon.view.memory import ESTIMATES, EVENTS, MOVES, Memory
from tests.daemon.view.view_kit import (
    FakeDaemon,
    RunningView,
    daemon_at,
    estimate,
    move,
    part,
    status,
    viewing,
    wait_until,
)

Channel = aiohttp.ClientWebSocketResponse


@pytest.fixture
def daemon(short_path: Path) -> Iterator[FakeDaemon]:
    with daemon_at(short_path / "live") as made:
        yield made


@pytest.fixture
def view(short_path: Path) -> Iterator[RunningView]:
    with viewing(short_path, silent_s=0.5) as running:
        yield running


def browse(view: RunningView, scene: Callable[[Channel], Awaitable[None]]) -> None:
    async def run() -> None:
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{view.url}/live") as channel:
            await asyncio.wait_for(scene(channel), 30)

    asyncio.run(run())


async def until(channel: Channel, kind: str, **wanted: Any) -> dict[str, Any]:
    """The next message of that kind with these values."""
    while True:
        message: dict[str, Any] = await channel.receive_json()
        if message["type"] == kind and all(message.get(name) == value for name, value in wanted.items()):
            return message


def test_a_browser_gets_a_snapshot_then_every_line_as_the_daemon_said_it(daemon: FakeDaemon, view: RunningView) -> None:
    daemon.moves, daemon.events = [move()], [{"t_s": 1.5, "what": "start proposed (push)"}]
    daemon.start(talk=False)
    wait_until(lambda: view.server.link.state.word == "up")

    async def scene(channel: Channel) -> None:
        first = await channel.receive_json()
        assert first["type"] == "snapshot"
        assert first["hello"] == {"version": "1.2.3", "stroke_mm": 500.0}
        assert first["moves"] == daemon.moves
        assert first["events"] == daemon.events
        assert first["status"]["displacement"] == daemon.status["displacement"]
        assert first["link"]["state"] == "up"
        for kind, content in (
            ("estimate", estimate(77.0, innovation=None)),
            ("status", status(can=part("ill", "no acknowledgement", "check"))),
            ("move", move("retract", 0.2)),
            ("event", {"t_s": 2.0, "what": "gap of 0.1 s in the inertial samples"}),
        ):
            daemon.push(kind, content)
            assert await until(channel, kind) == {"type": kind} | content

    browse(view, scene)


def test_a_page_that_is_opened_late_knows_the_last_minute(daemon: FakeDaemon, view: RunningView) -> None:
    daemon.start(talk=False)
    wait_until(lambda: daemon.viewers == 1)
    rows = [estimate(float(number)) for number in range(20)]
    for row in rows:
        daemon.push("estimate", row)
    daemon.push("move", move())
    wait_until(lambda: len(view.server.memory.snapshot()["moves"]) == 1)

    async def scene(channel: Channel) -> None:
        first = await channel.receive_json()
        assert first["estimates"] == rows
        assert len(first["moves"]) == 1

    browse(view, scene)


def test_the_memory_is_bounded_and_joins_what_a_new_daemon_says() -> None:
    memory = Memory()
    for number in range(2000):
        for kind in ("estimate", "move", "event"):
            memory.take({"type": kind, "number": number})
    kept = memory.snapshot()
    assert [len(kept[name]) for name in ("estimates", "moves", "events")] == [ESTIMATES, MOVES, EVENTS]
    assert kept["moves"][-1] == {"number": 1999}
    memory.take({"type": "hello", "moves": [{"number": 1999}, {"number": 5000}], "events": []})
    assert [row["number"] for row in memory.snapshot()["moves"][-2:]] == [1999, 5000]


def test_the_end_of_the_daemon_is_told_at_once_and_it_is_found_again(daemon: FakeDaemon, view: RunningView) -> None:
    daemon.start()

    async def scene(channel: Channel) -> None:
        await until(channel, "estimate")
        before_s = time.monotonic()
        await asyncio.to_thread(daemon.stop)
        gone = await until(channel, "link", state="down")
        assert before_s <= gone["since_s"] <= time.monotonic()
        assert gone["why"] == "ended"
        later = await until(channel, "link", state="down", why="absent")  # tried again
        assert later["since_s"] == gone["since_s"]
        await asyncio.to_thread(daemon.start)
        await until(channel, "link", state="up")
        assert (await until(channel, "snapshot"))["hello"]["version"] == "1.2.3"
        await until(channel, "estimate")

    browse(view, scene)


def test_a_daemon_that_is_connected_but_silent_is_told(daemon: FakeDaemon, view: RunningView) -> None:
    daemon.start()

    async def scene(channel: Channel) -> None:
        await until(channel, "estimate")
        await asyncio.to_thread(daemon.fall_silent)
        fell_s = time.monotonic()
        silent = await until(channel, "link", state="silent")
        assert silent["since_s"] == pytest.approx(fell_s, abs=0.4)
        assert daemon.viewers == 1
        await asyncio.to_thread(daemon.speak_again)
        await until(channel, "link", state="up")

    browse(view, scene)


def test_the_server_speaks_also_without_a_daemon(view: RunningView) -> None:
    async def scene(channel: Channel) -> None:
        first = await channel.receive_json()
        assert (first["hello"], first["status"], first["estimates"]) == (None, None, [])
        beats = [await until(channel, "link") for _ in range(3)]
        assert {beat["state"] for beat in beats} == {"down"}
        assert beats[-1]["now_s"] - beats[0]["now_s"] > 0.2

    browse(view, scene)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (b"SSH-2.0\n", "foreign"),
        (b"[]\n", "foreign"),
        (b'{"no":"type"}\n', "foreign"),
        (b'{"type":"hello","moves":null}\n', "foreign"),
        (b'{"type":"estimate","displacement_mm":NaN}\n', "foreign"),
        (b"\xff\xfe\n", "foreign"),
        (b"x" * (2 << 20), "foreign"),
        (b'{"type":"refused","viewers":16}\n', "full"),
        (b"", "ended"),
    ],
)
def test_what_answers_instead_of_a_daemon_is_named(answer: bytes, why: str, short_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as stranger:
        stranger.bind(str(short_path / "live"))
        stranger.listen()
        with viewing(short_path) as view:
            channel, _ = stranger.accept()
            with channel:
                try:
                    channel.sendall(answer)
                except OSError:
                    assert len(answer) > 1 << 20  # hung up on in the middle
            wait_until(lambda: view.server.link.state.why == why)
            assert view.server.link.state.word == "down"


def test_several_browsers_hear_the_same(daemon: FakeDaemon, view: RunningView) -> None:
    daemon.start(talk=False)
    wait_until(lambda: daemon.viewers == 1)

    async def run() -> None:
        async with aiohttp.ClientSession() as session:
            channels = [await session.ws_connect(f"{view.url}/live") for _ in range(5)]
            for channel in channels:
                await until(channel, "snapshot")
            row = estimate(200.25)
            daemon.push("estimate", row)
            assert [await until(channel, "estimate") for channel in channels] == [{"type": "estimate"} | row] * 5
            assert daemon.viewers == 1  # the daemon serves one, however many look
            for channel in channels:
                await channel.close()

    asyncio.run(asyncio.wait_for(run(), 30))
    wait_until(lambda: view.server.browsers.count == 0)


def test_one_browser_too_many_is_refused_and_told(view: RunningView) -> None:
    async def run() -> None:
        async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
            channels = [await session.ws_connect(f"{view.url}/live") for _ in range(BROWSERS)]
            wait_until(lambda: view.server.browsers.count == BROWSERS)
            late = await session.ws_connect(f"{view.url}/live")
            assert await late.receive_json() == {"type": "refused", "browsers": BROWSERS}
            assert (await late.receive()).type is aiohttp.WSMsgType.CLOSE
            assert late.close_code == 1013
            await channels.pop().close()
            wait_until(lambda: view.server.browsers.count == BROWSERS - 1)
            again = await session.ws_connect(f"{view.url}/live")
            assert (await again.receive_json())["type"] == "snapshot"
            for channel in [*channels, again]:
                await channel.close()

    asyncio.run(asyncio.wait_for(run(), 30))


def deaf_browser_at(port: int) -> socket.socket:
    """Opens the WebSocket by hand and then reads nothing."""
    channel = socket.create_connection(("127.0.0.1", port))
    channel.sendall(
        f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
    )
    return channel


def test_a_browser_that_stops_reading_loses_the_oldest_and_holds_up_nobody(
    daemon: FakeDaemon, view: RunningView
) -> None:
    daemon.start(talk=False)
    wait_until(lambda: daemon.viewers == 1)
    pad, count, heap = "x" * 20_000, 400, 20

    async def scene(channel: Channel) -> None:
        await until(channel, "snapshot")
        for number in range(count):
            daemon.push("event", {"t_s": 0.0, "what": pad, "number": number})
            if number % heap == heap - 1:
                heard.extend([(await until(channel, "event"))["number"] for _ in range(heap)])

    heard: list[int] = []
    with deaf_browser_at(view.port) as deaf:
        wait_until(lambda: view.server.browsers.count == 1)
        browse(view, scene)
        assert heard == list(range(count))  # who reads misses nothing
        dropped = view.server.browsers.dropped
        held = sum(len(text) for one in view.server.browsers._browsers for text in one._messages)
        waiting = BUFFER_BYTES + 4 * KERNEL_BYTES
        assert dropped >= count - MESSAGES_PER_BROWSER - waiting // len(pad) - 10
        assert held <= MESSAGES_PER_BROWSER * (len(pad) + 200)
        # What it finds when it reads again: old ones up to the loss, how many were lost, the newest ones.
        deaf.settimeout(5)
        daemon.push("last", {})
        received = b""
        while b'"last"' not in received:
            received += (piece := deaf.recv(1 << 20))
            assert piece
        lost = int(received.split(b'{"type":"dropped","messages":')[-1].split(b"}")[0])
        assert lost >= dropped
        assert f'"number":{count - 1}'.encode() in received
    wait_until(lambda: view.server.browsers.count == 0)
    assert view.server.browsers.dropped >= dropped


def test_a_message_beyond_a_kilobyte_closes_and_smaller_ones_are_ignored(view: RunningView) -> None:
    async def scene(channel: Channel) -> None:
        await until(channel, "snapshot")
        await channel.send_str("x" * LARGEST_INCOMING)
        await channel.send_str(json.dumps({"type": "estimate", "displacement_mm": 1}))
        await channel.send_bytes(b"\x00" * 100)
        await until(channel, "link")
        await until(channel, "link")
        await channel.send_str("x" * (LARGEST_INCOMING + 1))
        while (message := await channel.receive()).type is aiohttp.WSMsgType.TEXT:
            assert json.loads(message.data)["type"] in ("link", "reports")
        assert channel.close_code == 1009

    browse(view, scene)
    assert view.server.memory.snapshot()["estimates"] == []
