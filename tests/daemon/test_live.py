"""The live socket: viewers are served, and no viewer can harm anybody."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import stat
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from daemon.errors import CommandError
from daemon.service.live import LINES_PER_VIEWER, VIEWERS, WRITE_BUFFER_BYTES, LiveServer
from daemon.service.live_client import first_line

HELLO = {"version": "1", "estimate": None}


def serve(path: Path, scene: Callable[[LiveServer], Awaitable[None]]) -> None:
    """Run `scene` while a server listens on `path`."""

    async def run() -> None:
        server = LiveServer(path, lambda: HELLO)
        await server.start()
        try:
            await asyncio.wait_for(scene(server), 20)
        finally:
            await server.close()

    asyncio.run(run())


async def read(reader: asyncio.StreamReader) -> dict[str, Any]:
    line: dict[str, Any] = json.loads(await reader.readline())
    return line


async def until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(0.001)


def test_a_viewer_gets_the_greeting_and_then_every_line_in_order(short_path: Path) -> None:
    async def scene(server: LiveServer) -> None:
        reader, writer = await asyncio.open_unix_connection(short_path / "s")
        assert await read(reader) == {"type": "hello"} | HELLO
        for number in range(20):
            server.push("event", {"number": number})
        assert [(await read(reader))["number"] for _ in range(20)] == list(range(20))
        assert (server.viewers, server.dropped) == (1, 0)
        writer.close()
        await until(lambda: server.viewers == 0)

    serve(short_path / "s", scene)


def test_without_viewers_nothing_is_even_encoded(short_path: Path) -> None:
    async def scene(server: LiveServer) -> None:
        server.push("event", {"not": object()})

    serve(short_path / "s", scene)


def test_a_slow_viewer_loses_the_oldest_lines_and_is_told_how_many(short_path: Path) -> None:
    pad, count = "x" * 1000, 3000

    async def scene(server: LiveServer) -> None:
        reader, slow = await asyncio.open_unix_connection(short_path / "s", limit=4096)
        other, quick = await asyncio.open_unix_connection(short_path / "s")
        await read(other)
        for number in range(count):
            server.push("event", {"number": number, "pad": pad})
            assert (await read(other))["number"] == number  # who reads at once misses nothing
        server.push("last", {})
        lost, numbers = 0, []
        await read(reader)
        while (line := await read(reader))["type"] != "last":
            if line["type"] == "dropped":
                lost = line["lines"]
            else:
                numbers.append(line["number"])
        assert numbers == sorted(numbers)
        assert numbers[0] == 0  # in the kernel's buffers before the viewer was late
        assert numbers[-LINES_PER_VIEWER + 1 :] == list(range(count - LINES_PER_VIEWER + 1, count))
        assert lost == count - len(numbers) == server.dropped > 0
        # What waited was bounded: our queue, our write buffer, and the kernel's socket buffers.
        kernel = 4 * socket.socket(socket.AF_UNIX).getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF)
        assert len(numbers) * 1000 < LINES_PER_VIEWER * 1100 + WRITE_BUFFER_BYTES + kernel
        slow.close()
        quick.close()

    serve(short_path / "s", scene)


def test_lines_lost_by_a_viewer_that_has_left_stay_counted(short_path: Path) -> None:
    async def scene(server: LiveServer) -> None:
        _, writer = await asyncio.open_unix_connection(short_path / "s")
        await until(lambda: server.viewers == 1)
        for number in range(LINES_PER_VIEWER + 50):
            server.push("event", {"number": number})
        dropped = server.dropped
        assert dropped >= 50
        writer.close()
        await until(lambda: server.viewers == 0)
        assert server.dropped == dropped

    serve(short_path / "s", scene)


def test_a_viewer_that_sends_junk_is_served_all_the_same(short_path: Path) -> None:
    async def scene(server: LiveServer) -> None:
        reader, writer = await asyncio.open_unix_connection(short_path / "s")
        writer.write(b"\xff\x00{]\n" * 200_000)
        await writer.drain()
        await read(reader)
        server.push("event", {"number": 1})
        assert await read(reader) == {"type": "event", "number": 1}

    serve(short_path / "s", scene)


def test_a_viewer_that_vanishes_leaves_no_trace(short_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async def scene(server: LiveServer) -> None:
        for _ in range(20):
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as viewer:
                viewer.connect(str(short_path / "s"))
            for number in range(50):
                server.push("event", {"number": number, "pad": "x" * 5000})
                await asyncio.sleep(0)
        await until(lambda: server.viewers == 0)

    with caplog.at_level(logging.WARNING):
        serve(short_path / "s", scene)
    assert caplog.records == []


def test_one_viewer_too_many_is_refused_and_told(short_path: Path) -> None:
    async def scene(server: LiveServer) -> None:
        viewers = [await asyncio.open_unix_connection(short_path / "s") for _ in range(VIEWERS)]
        for reader, _ in viewers:
            assert (await read(reader))["type"] == "hello"
        reader, _ = await asyncio.open_unix_connection(short_path / "s")
        assert await reader.read() == b'{"type":"refused","viewers":16}\n'  # and the end of the file
        assert (server.viewers, server.refused) == (VIEWERS, 1)
        with pytest.raises(CommandError, match="serves as many viewers as it can: close one of them"):
            await asyncio.to_thread(first_line, short_path / "s")
        viewers[0][1].close()
        await until(lambda: server.viewers == VIEWERS - 1)
        reader, _ = await asyncio.open_unix_connection(short_path / "s")
        assert (await read(reader))["type"] == "hello"

    serve(short_path / "s", scene)


def test_the_socket_is_for_owner_and_group_and_goes_with_the_server(short_path: Path) -> None:
    path = short_path / "made" / "on demand" / "s"

    async def scene(server: LiveServer) -> None:
        assert stat.S_IMODE(path.stat().st_mode) == 0o660

    serve(path, scene)
    assert not path.exists()


def test_closing_ends_the_connection_of_every_viewer_slow_ones_too(
    short_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def run() -> None:
        server = LiveServer(short_path / "s", lambda: HELLO)
        await server.start()
        viewers = [await asyncio.open_unix_connection(short_path / "s") for _ in range(3)]
        for reader, _ in viewers:
            await read(reader)
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as slow:
            slow.connect(str(short_path / "s"))
            await until(lambda: server.viewers == 4)
            while not server.dropped:
                server.push("event", {"pad": "x" * 10_000})
                for reader, _ in viewers:
                    await read(reader)
            await asyncio.wait_for(server.close(), 10)
        assert [await asyncio.wait_for(reader.read(), 10) for reader, _ in viewers] == [b""] * 3
        for _, writer in viewers:
            writer.close()

    with caplog.at_level(logging.WARNING):
        asyncio.run(run())
    assert caplog.records == []


def test_the_end_with_viewers_still_there_is_quiet(short_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async def scene(server: LiveServer) -> None:
        for viewer in viewers:
            viewer.connect(str(short_path / "s"))
        await until(lambda: server.viewers == len(viewers))

    viewers = [socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) for _ in range(3)]
    with caplog.at_level(logging.WARNING):
        serve(short_path / "s", scene)
    assert caplog.records == []
    for viewer in viewers:
        viewer.close()


def leave_stale_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(path))


def test_the_socket_of_a_killed_daemon_is_replaced(short_path: Path) -> None:
    leave_stale_socket(short_path / "s")

    async def scene(server: LiveServer) -> None:
        reader, _ = await asyncio.open_unix_connection(short_path / "s")
        assert (await read(reader))["type"] == "hello"

    serve(short_path / "s", scene)


def test_a_daemon_that_answers_is_not_driven_out(short_path: Path) -> None:
    async def scene(server: LiveServer) -> None:
        with pytest.raises(OSError, match="another daemon already serves it") as refused:
            await LiveServer(short_path / "s", lambda: HELLO).start()
        assert str(short_path / "s") in str(refused.value)
        reader, _ = await asyncio.open_unix_connection(short_path / "s")
        assert (await read(reader))["type"] == "hello"

    serve(short_path / "s", scene)


def test_a_busy_daemon_that_cannot_answer_at_once_is_not_driven_out(short_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as busy:
        busy.bind(str(short_path / "s"))
        busy.listen(0)
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as waiting:
            waiting.connect(str(short_path / "s"))  # fills the queue of connections
            with pytest.raises(OSError, match="cannot serve viewers on"):
                asyncio.run(LiveServer(short_path / "s", lambda: HELLO).start())
        assert (short_path / "s").is_socket()


def test_a_file_in_the_way_is_refused_and_kept(short_path: Path) -> None:
    path = short_path / "s"
    path.write_text("mine")
    with pytest.raises(OSError, match=r"cannot serve viewers on .*it exists and is no socket"):
        asyncio.run(LiveServer(path, lambda: HELLO).start())
    assert path.read_text() == "mine"


def test_a_place_where_no_socket_can_be_is_refused_by_name(short_path: Path) -> None:
    too_long = short_path / ("x" * 150)
    (short_path / "file").touch()
    for path in (too_long, short_path / "file" / "s"):
        with pytest.raises(OSError, match=r"correct service\.socket") as refused:
            asyncio.run(LiveServer(path, lambda: HELLO).start())
        assert str(path) in str(refused.value)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (b"", "has ended"),
        (b"SSH-2.0\n", "is no ramstroke daemon"),
        (b"[]\n", "is no ramstroke daemon"),
        (b'{"type":"estimate"}\n', "is no ramstroke daemon"),
        (b'{"type":"hello","moves":null}\n', "is no ramstroke daemon"),
        (b'{"type":"hello","t_s":NaN}\n', "is no ramstroke daemon"),
        (b"\xff\n", "is no ramstroke daemon"),
    ],
)
def test_the_client_tells_a_daemon_from_something_else(answer: bytes, said: str, short_path: Path) -> None:
    async def run() -> None:
        async def greet(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(answer)
            writer.close()

        async with await asyncio.start_unix_server(greet, short_path / "s"):
            with pytest.raises(CommandError, match=said):
                await asyncio.to_thread(first_line, short_path / "s")

    asyncio.run(run())


def test_the_client_says_when_nobody_answers(short_path: Path) -> None:
    with pytest.raises(CommandError, match=r"no daemon answers on .*/s .*: start `ramstroke run`"):
        first_line(short_path / "s")
