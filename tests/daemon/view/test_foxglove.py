"""The live source for Foxglove and Lichtblick, read by a plain WebSocket client that speaks their protocol."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from daemon.errors import CommandError, UsageError
from daemon.view.foxglove.channels import SCHEMAS
from daemon.view.foxglove.server import BACKLOG, serve
from tests.daemon.live_kit import FakeDaemon, estimate, status

PATIENCE_S = 30.0
MESSAGE_DATA = 1
HEAD = struct.Struct("<BIQ")  # opcode, subscription, log time
MOVE = {"kind": "push", "onset_s": 1.0, "stop_s": 2.0, "start_mm": 0.0, "end_mm": 499.5, "sigma_mm": 0.5}


@contextmanager
def serving(path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The server as a program, and its address."""
    config = path.with_name("view.toml")
    config.write_text(f'[service]\nsocket = "{path}"\n')
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "daemon.cli", "view", "--foxglove", "--config", str(config), "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process, process.stdout.readline().strip().removeprefix("for Foxglove and Lichtblick: ")
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


class Client:
    """Subscribes to all that is advertised."""

    def __init__(self, web: aiohttp.ClientWebSocketResponse) -> None:
        self._web = web
        self.channels: dict[int, dict[str, Any]] = {}
        self.told: list[dict[str, Any]] = []

    async def next(self) -> tuple[str, dict[str, Any], bytes]:
        """Topic, content and bytes of the next message; whatever else the server says is kept in `told`."""
        while True:
            message = await asyncio.wait_for(self._web.receive(), PATIENCE_S)
            if message.type is aiohttp.WSMsgType.BINARY:
                opcode, channel, _ = HEAD.unpack_from(message.data)
                assert opcode == MESSAGE_DATA
                raw = message.data[HEAD.size :]
                return self.channels[channel]["topic"], json.loads(raw), raw
            assert message.type is aiohttp.WSMsgType.TEXT, message
            said = json.loads(message.data)
            self.told.append(said)
            if said["op"] == "advertise":
                self.channels |= {channel["id"]: channel for channel in said["channels"]}
                wanted = [{"id": number, "channelId": number} for number in self.channels]
                await self._web.send_json({"op": "subscribe", "subscriptions": wanted})

    async def until(self, topic: str, condition: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
        while True:
            found, content, _ = await self.next()
            if found == topic and condition(content):
                return content


def scene(url: str, play: Callable[[Client], Awaitable[None]]) -> None:
    async def run() -> None:
        async with aiohttp.ClientSession() as session, session.ws_connect(url, protocols=["foxglove.sdk.v1"]) as web:
            assert web.protocol == "foxglove.sdk.v1"
            await play(Client(web))

    asyncio.run(asyncio.wait_for(run(), 2 * PATIENCE_S))


def test_every_line_arrives_as_it_was_sent(short_path: Path) -> None:
    with FakeDaemon(short_path / "s") as daemon, serving(short_path / "s") as (process, url):

        async def play(client: Client) -> None:
            keep_going = asyncio.ensure_future(repeat(lambda: daemon.send("status", status())))
            await client.until("/live/status")  # subscribed
            keep_going.cancel()
            sent = [("estimate", estimate(number * 1.5)) for number in range(20)]
            sent += [("move", MOVE), ("event", {"t_s": 1.5, "what": "it came to pass"}), ("dropped", {"lines": 3})]
            for kind, content in sent:
                daemon.send(kind, content)
            got: list[tuple[str, dict[str, Any]]] = []
            while len(got) < len(sent):
                topic, content, _ = await client.next()
                if topic not in ("/live/status", "/live/log"):
                    got.append((topic, content))
            assert got == [(f"/live/{kind}", {"type": kind} | content) for kind, content in sent]
            for channel in client.channels.values():
                assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
                assert json.loads(channel["schema"]) == SCHEMAS[channel["topic"]]
                assert channel["schemaName"] == SCHEMAS[channel["topic"]]["title"]
            assert {channel["topic"] for channel in client.channels.values()} == set(SCHEMAS)

        scene(url, play)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ""


async def repeat(work: Callable[[], None]) -> None:
    while True:
        work()
        await asyncio.sleep(0.05)


def test_events_are_lines_of_the_log_panel(short_path: Path) -> None:
    with FakeDaemon(short_path / "s") as daemon, serving(short_path / "s") as (_, url):

        async def play(client: Client) -> None:
            saying = asyncio.ensure_future(repeat(lambda: daemon.send("event", {"t_s": 1.0, "what": "stop confirmed"})))
            line = await client.until("/live/log", lambda content: content["message"] == "stop confirmed")
            saying.cancel()
            assert set(line) == set(SCHEMAS["/live/log"]["properties"])
            assert line["level"] == 2
            assert abs(line["timestamp"]["sec"] - time.time()) < PATIENCE_S

        scene(url, play)


def test_what_the_daemon_sends_has_the_types_of_the_schemas() -> None:
    types: dict[str, Any] = {"number": (int, float), "integer": int, "string": str, "object": dict}
    for topic, content in (("/live/estimate", estimate()), ("/live/status", status()), ("/live/move", MOVE)):
        for name, value in content.items():
            schema = SCHEMAS[topic]["properties"].get(name)
            if schema is not None:
                assert isinstance(value, types[schema["type"]]), name


def test_the_end_of_the_daemon_is_told_and_its_return(short_path: Path) -> None:
    with serving(short_path / "s") as (_, url):

        async def play(client: Client) -> None:
            daemon = FakeDaemon(short_path / "s")
            await asyncio.to_thread(daemon.__enter__)
            saying = asyncio.ensure_future(repeat(lambda: daemon.send("estimate", estimate())))
            await client.until("/live/estimate")
            saying.cancel()
            await asyncio.to_thread(daemon.__exit__, None, None, None)
            line = await client.until("/live/log", lambda content: "has ended" in content["message"])
            assert line["level"] == 3
            second = FakeDaemon(short_path / "s")
            await asyncio.to_thread(second.__enter__)
            await client.until("/live/log", lambda content: content["message"] == "the daemon is back")
            warnings = [said for said in client.told if said["op"] == "status"]
            assert any("has ended" in said["message"] for said in warnings)
            saying = asyncio.ensure_future(repeat(lambda: second.send("estimate", estimate(77.0))))
            await client.until("/live/estimate", lambda content: content["displacement_mm"] == 77.0)
            saying.cancel()
            assert any(said["op"] == "removeStatus" for said in client.told)
            await asyncio.to_thread(second.__exit__, None, None, None)

        scene(url, play)


def test_several_clients_get_the_same(short_path: Path) -> None:
    with FakeDaemon(short_path / "s") as daemon, serving(short_path / "s") as (_, url):

        async def run() -> None:
            async with aiohttp.ClientSession() as session:
                webs = [await session.ws_connect(url, protocols=["foxglove.sdk.v1"]) for _ in range(3)]
                clients = [Client(web) for web in webs]
                saying = asyncio.ensure_future(repeat(lambda: daemon.send("status", status())))
                for client in clients:
                    await client.until("/live/status")
                saying.cancel()
                daemon.send("estimate", estimate(321.0))
                for client in clients:
                    await client.until("/live/estimate", lambda content: content["displacement_mm"] == 321.0)
                for web in webs:
                    await web.close()

        asyncio.run(asyncio.wait_for(run(), 2 * PATIENCE_S))


def resident_bytes(process: subprocess.Popen[str]) -> int:
    pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def test_a_client_that_does_not_read_costs_nothing_and_disturbs_nobody(short_path: Path) -> None:
    """Sixty megabytes for a client that reads none of them; another reads on to the end."""
    pad, count = "x" * 10_000, 6000
    with FakeDaemon(short_path / "s") as daemon, serving(short_path / "s") as (process, url):

        async def run() -> None:
            async with (
                aiohttp.ClientSession() as session,
                aiohttp.ClientSession() as lazy_session,
                lazy_session.ws_connect(url, protocols=["foxglove.sdk.v1"], max_msg_size=0) as lazy,
                session.ws_connect(url, protocols=["foxglove.sdk.v1"]) as web,
            ):
                quick, slow = Client(web), Client(lazy)
                saying = asyncio.ensure_future(repeat(lambda: daemon.send("status", status())))
                await slow.until("/live/status")
                await quick.until("/live/status")
                saying.cancel()
                lazy._response.connection.transport.pause_reading()  # type: ignore[union-attr]  # nobody reads on
                before = resident_bytes(process)
                for number in range(count):
                    content = {"t_s": float(number), "what": pad}
                    await asyncio.to_thread(daemon.send, "event", content)
                    await quick.until("/live/event", lambda got, n=number: got["t_s"] == n)  # type: ignore[misc]
                grown = resident_bytes(process) - before
            # Two messages a line, one for the log; and the process' own unevenness.
            assert grown < 2 * BACKLOG * len(pad) + 15_000_000, grown
            assert 2 * count * len(pad) > 5 * (2 * BACKLOG * len(pad) + 15_000_000)

        asyncio.run(asyncio.wait_for(run(), 120))


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "::", "example.com", ""])
def test_only_this_computer_is_served(host: str, short_path: Path) -> None:
    with pytest.raises(UsageError, match=r"knows no password.*ssh -L 9000:127\.0\.0\.1:9000"):
        serve(short_path / "s", host, 9000)


def test_a_port_in_use_is_told(short_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(CommandError, match=f"cannot serve 127.0.0.1, port {port} .*: choose another --port"):
            serve(short_path / "s", "127.0.0.1", port)


def test_without_the_package_it_says_what_to_install(short_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(CommandError, match=r"foxglove-sdk: `systemd/install.sh --with foxglove WHEEL`"):
        serve(short_path / "s")
