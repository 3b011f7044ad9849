"""What the tests of the CAN link share: links on networks that nobody else uses, and buses with odd habits."""

from __future__ import annotations

import asyncio
import errno
import itertools
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any

import can
import pytest

from drivers.can.bus import CanBus
from drivers.can.frame import Frame
from drivers.can.settings import CanSettings
from drivers.clock import SystemClock
from drivers.condition import Wellness
from drivers.virtual.can_network import NetworkBus, network

_numbers = itertools.count()


def unused_channel() -> str:
    """A network that no other test has touched."""
    return f"test{next(_numbers)}"


def message(number: int, **options: Any) -> can.Message:
    return can.Message(arbitration_id=number, data=bytes([number % 256]), is_extended_id=False, **options)


def nobody(frame: Frame) -> None:
    pytest.fail(f"nobody expects {frame}")


def run(scenario: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(scenario, 60))


async def cancel(task: asyncio.Task[None]) -> None:
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task


class Bench:
    """A link on a network of its own, and a peer to talk to it."""

    def __init__(self, *, listen_only: bool = True, **options: Any) -> None:
        self.frames: list[Frame] = []
        self.settings = CanSettings(interface="virtual", channel=unused_channel(), listen_only=listen_only)
        self.network = network(self.settings.channel)
        self.peer = NetworkBus(self.settings.channel)
        self._news = asyncio.Event()
        self.link = CanBus(
            self.settings, options.pop("on_frame", self._on_frame), options.pop("clock", SystemClock()), **options
        )

    def _on_frame(self, frame: Frame) -> None:
        self.frames.append(frame)

    async def __aenter__(self) -> Bench:
        self.task = asyncio.create_task(self.link.run())
        await self.until(lambda: self.link.progress > 0 or self.is_open)
        return self

    async def __aexit__(self, *exception: object) -> None:
        await cancel(self.task)
        self.peer.shutdown()

    @property
    def is_open(self) -> bool:
        """Whether the link has a bus."""
        return self.link.condition.word is not Wellness.WAITING

    async def until(self, holds: Callable[[], bool]) -> None:
        """Let the loop turn until `holds()`; the link's end is raised here."""
        async with asyncio.timeout(30):
            while not holds():
                if self.task.done():
                    self.task.result()
                await asyncio.sleep(0.001)

    async def frames_come(self, count: int) -> None:
        """Until `count` frames have been handed on."""
        await self.until(lambda: len(self.frames) >= count)


def openings(*buses: Callable[[str], can.BusABC] | Exception) -> Callable[[CanSettings, object], can.BusABC]:
    """An opener that makes, or raises, the next of `buses` each time; then there is none."""
    left = iter(buses)

    def open_next(settings: CanSettings, ids: object) -> can.BusABC:
        bus = next(left, OSError(errno.ENODEV, "No such device"))
        if isinstance(bus, Exception):
            raise bus
        return bus(settings.channel)

    return open_next


class OddBus(NetworkBus):
    """A bus whose `recv` first gives, or raises, what `script` says, and whose descriptor is readable meanwhile."""

    def __init__(self, channel: str, *script: can.Message | Exception, send_error: Exception | None = None) -> None:
        super().__init__(channel)
        self._script = list(script)
        self._send_error = send_error
        self.closed = False
        self.enqueue(b"")  # makes it readable

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._script:
            return super()._recv_internal(timeout)
        item = self._script.pop(0)
        if isinstance(item, Exception):
            raise item
        return item, True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self._send_error is not None:
            raise self._send_error
        super().send(msg, timeout)

    def shutdown(self) -> None:
        super().shutdown()
        self.closed = True


class ReadableBus(NetworkBus):
    """A bus whose descriptor is readable for ever and that gives `item` each time, for ever."""

    def __init__(self, channel: str, item: can.Message | None) -> None:
        super().__init__(channel)
        self._item = item
        self.enqueue(b"never read")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self._item, True
