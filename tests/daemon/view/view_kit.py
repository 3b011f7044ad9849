"""A daemon's socket that says what a test wants, and `ramstroke view` in front of it, both in threads of their own."""

from __future__ import annotations

import asyncio
import socket
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from daemon.service.live import LiveServer
from daemon.view.guard import Guard
from daemon.view.server import ViewServer, serve

PATIENCE_S = 30.0
STROKE_MM = 500.0
Result = TypeVar("Result")


def part(state: str = "ok", what: str = "", advice: str = "", **counted: Any) -> dict[str, Any]:
    """A part of the status."""
    return {"state": state, "since_s": time.monotonic() - 5, "what": what, "advice": advice} | counted


def status(**parts: dict[str, Any]) -> dict[str, Any]:
    """A healthy one, save for the parts that are given."""
    healthy = {
        "imu": part(samples=81920),
        "jy901": part("off"),
        "can": part(received=1200),
        "displacement": part(rate_hz=12.3, age_s=0.05),
        "estimator": part(samples=81920),
        "recorder": part(file="/nowhere/ramstroke-20260101T000000Z.mcap", bytes=5_800_000),
        "loop": part(late_ms=1.2, culprit=""),
        "live": {"viewers": 1, "dropped": 0, "refused": 0},
    }
    return {"state": "ok", "t_s": time.monotonic(), "estimate": None, "learned": None} | healthy | parts


def estimate(stroke_mm: float = 123.4, **values: Any) -> dict[str, Any]:
    """One row as the daemon pushes it."""
    row = {
        "t_s": time.monotonic(),
        "displacement_mm": stroke_mm,
        "sigma_mm": 1.5,
        "velocity_mm_s": 14.5,
        "segment": "CVS",
        "can_state": "ok",
        "move": 1,
        "velocity_sigma_mm_s": 0.2,
        "acceleration_m_s2": 0.01,
        "chart_lower_m_s2": -0.08,
        "chart_upper_m_s2": 0.08,
        "observed_s": time.monotonic(),
        "observed_mm": stroke_mm - 4,
    }
    return row | values


def move(kind: str = "push", end_mm: float = 499.6) -> dict[str, Any]:
    """A finished move."""
    stop_s = time.monotonic() - 2
    return {
        "kind": kind,
        "onset_s": stop_s - 34.2,
        "stop_s": stop_s,
        "start_mm": 0.4,
        "end_mm": end_mm,
        "sigma_mm": 0.6,
        "end_before_stop_mm": end_mm - 2,
        "sigma_before_stop_mm": 2.1,
        "velocity_mm_s": 14.6,
        "can_state": "ok",
        "tier": "settled",
    }


class Loop:
    """An event loop in a thread."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self._thread.start()

    def do(self, work: Awaitable[Result]) -> Result:
        async def wait() -> Result:
            return await work

        return asyncio.run_coroutine_threadsafe(wait(), self.loop).result(PATIENCE_S)

    def close(self) -> None:
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(PATIENCE_S)
        self.loop.close()


class FakeDaemon:
    """The daemon's own socket server, told what to say; `talk` makes it say estimate and status as the daemon would."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.status = status()
        self.moves: list[dict[str, Any]] = []
        self.events: list[dict[str, Any]] = []
        self.row: Callable[[], dict[str, Any]] = estimate
        self.said: list[dict[str, Any]] = []  # estimates
        self._server: LiveServer | None = None
        self._talking: asyncio.Task[None] | None = None
        self.loop = Loop()

    def _hello(self) -> dict[str, Any]:
        past = {"moves": self.moves, "events": self.events}
        return {"version": "1.2.3", "stroke_mm": STROKE_MM} | past | self.status | {"t_s": time.monotonic()}

    def start(self, *, talk: bool = True) -> None:
        async def begin() -> None:
            self._server = LiveServer(self.path, self._hello)
            await self._server.start()
            if talk:
                self._talking = asyncio.ensure_future(self._talk())

        self.loop.do(begin())

    def stop(self) -> None:
        """As a daemon that ends."""

        async def end() -> None:
            await self._hush()
            if self._server is not None:
                await self._server.close()
                self._server = None

        self.loop.do(end())

    def fall_silent(self) -> None:
        """Connected, but nothing comes."""
        self.loop.do(self._hush())

    def speak_again(self) -> None:
        async def begin() -> None:
            self._talking = asyncio.ensure_future(self._talk())

        self.loop.do(begin())

    def push(self, kind: str, content: dict[str, Any]) -> None:
        async def one() -> None:
            assert self._server is not None
            self._server.push(kind, content)

        self.loop.do(one())

    @property
    def viewers(self) -> int:
        return 0 if self._server is None else self._server.viewers

    def close(self) -> None:
        self.stop()
        self.loop.close()

    async def _talk(self) -> None:
        count = 0
        while True:
            assert self._server is not None
            self.said.append(self.row())
            self._server.push("estimate", self.said[-1])
            if count % 10 == 0:
                self._server.push("status", self.status | {"t_s": time.monotonic()})
            count += 1
            await asyncio.sleep(0.1)

    async def _hush(self) -> None:
        if self._talking is not None:
            self._talking.cancel()
            await asyncio.gather(self._talking, return_exceptions=True)
            self._talking = None


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class RunningView:
    """`ramstroke view` in a thread."""

    def __init__(self, folder: Path, token: str | None = None, *, loopback: bool = True, port: int = 0, **more: Any):
        self.port = port or free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.folder = folder
        for name in ("recordings", "scratch"):
            (folder / name).mkdir(exist_ok=True)
        guard = Guard(token, loopback=loopback, port=self.port)
        self.server = ViewServer(folder / "live", folder / "recordings", folder / "scratch", guard, **more)
        self._loop = Loop()
        self._stopping = self._loop.do(_event())
        listening = threading.Event()
        self._ended = asyncio.run_coroutine_threadsafe(
            serve(self.server, "127.0.0.1", self.port, self._stopping, listening.set), self._loop.loop
        )
        assert listening.wait(PATIENCE_S)

    def do(self, work: Awaitable[Result]) -> Result:
        """On its loop."""
        return self._loop.do(work)

    def close(self) -> None:
        self._loop.loop.call_soon_threadsafe(self._stopping.set)
        self._ended.result(PATIENCE_S)
        self._loop.close()


async def _event() -> asyncio.Event:
    return asyncio.Event()


@contextmanager
def viewing(folder: Path, token: str | None = None, **more: Any) -> Iterator[RunningView]:
    """A view that is closed at the end."""
    running = RunningView(folder, token, **more)
    try:
        yield running
    finally:
        running.close()


@contextmanager
def daemon_at(path: Path) -> Iterator[FakeDaemon]:
    """A fake daemon, not started yet."""
    made = FakeDaemon(path)
    try:
        yield made
    finally:
        made.close()


def wait_until(condition: Callable[[], bool]) -> None:
    """Raises AssertionError if it does not come true."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "it does not come true"
        time.sleep(0.01)


def report_command(program: str) -> Callable[[Path, Path], list[str]]:
    """In place of `ramstroke review`: a program that finds recording and report in sys.argv."""
    return lambda recording, report: [sys.executable, "-c", program, str(recording), str(report)]
