"""The inertial sensor's thread: starts the part, starts it again, and says what is wrong meanwhile."""

from __future__ import annotations

import logging
import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from daemon import imu_link
from daemon.imu_link import ImuLink, open_ports
from daemon.settings import Settings
from daemon.virtual import virtual_part, virtual_support
from drivers.adis16448.burst import Burst, Fault
from drivers.adis16448.configuration import ImuSettings
from drivers.clock import Clock, SystemClock
from drivers.data_ready import DataReady, DataReadyError
from drivers.spi import SpiError, SpiTransport
from drivers.virtual.support import VirtualSupport

PATIENCE_S = 30.0
SETTINGS = Settings.model_validate({"imu": {"transport": "virtual"}})


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


class Wire:
    """The way to a virtual part, which can be cut; then it reads zeros."""

    def __init__(self, part: SpiTransport | None) -> None:
        self._part = part
        self.is_cut = False
        self.error: Exception | None = None
        self.closed = 0

    def transfer(self, data: bytes, speed_hz: int) -> bytes:
        if self.error is not None:
            raise self.error
        assert self._part is not None
        answer = self._part.transfer(data, speed_hz)
        return bytes(len(answer)) if self.is_cut else answer

    def close(self) -> None:
        self.closed += 1


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Wire:
    """The wire of every link of the test; waiting times are short."""
    clock = SystemClock()
    part = virtual_part(virtual_support(SETTINGS, start_ns=clock.now_ns()), clock)
    wire = Wire(part)

    def ports(*_: object) -> tuple[SpiTransport, DataReady]:
        return wire, part.data_ready(pin=1, active_high=True)

    monkeypatch.setattr(imu_link, "open_ports", ports)
    for name, value in {"FIRST_RETRY_S": 0.02, "LONGEST_RETRY_S": 0.05, "DEAD_S": 0.2}.items():
        monkeypatch.setattr(imu_link, name, value)
    return wire


@pytest.fixture
def blocks() -> list[list[Burst]]:
    return []


@pytest.fixture
def link(wire: Wire, blocks: list[list[Burst]]) -> Iterator[ImuLink]:
    link = ImuLink(SETTINGS, SystemClock(), blocks.append)
    yield link
    if link._thread.is_alive():
        link.stop()
    assert not link._thread.is_alive()


def test_a_good_part_is_started_once_and_its_blocks_are_handed_over(
    link: ImuLink, wire: Wire, blocks: list[list[Burst]]
) -> None:
    assert link.health() == {"state": "waiting: not started yet", "starts": 0}
    link.start()
    until(lambda: len(blocks) > 10)
    health = link.health()
    assert (health["state"], health["starts"], health["paced"]) == ("running", 1, False)
    assert link.identity is not None
    assert health["serial"] == link.identity.serial
    assert health["samples"] >= 80
    assert {burst.fault for block in blocks for burst in block} <= {Fault.NONE, Fault.CRC}
    link.stop()
    handed_over = len(blocks)
    assert wire.closed == 1
    assert not [t for t in threading.enumerate() if t.name in ("imu", "acquisition")]
    assert len(blocks) == handed_over


def test_a_wire_that_breaks_and_heals_costs_only_the_time_between(
    link: ImuLink, wire: Wire, blocks: list[list[Burst]], caplog: pytest.LogCaptureFixture
) -> None:
    link.start()
    until(lambda: len(blocks) > 5)
    wire.is_cut = True
    until(lambda: link.state.startswith("waiting: ") and wire.closed >= 3)
    bad = [burst.fault for block in blocks for burst in block if burst.fault is not Fault.NONE]
    assert Fault.ALL_ZERO in bad
    reason = link.state
    wire.is_cut = False
    until(lambda: link.state == "running")
    healed = len(blocks)
    until(lambda: len(blocks) > healed + 5)
    assert link.starts == 2
    assert blocks[-1][-1].fault in (Fault.NONE, Fault.CRC)
    complaints = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert any("no good sample for 0.2 s" in line for line in complaints)
    # The same reason is not told at every try.
    assert complaints.count(f"no inertial samples: {reason.removeprefix('waiting: ')}") == 1


def test_what_nobody_foresaw_is_survived_too_and_told_with_its_place(
    link: ImuLink, wire: Wire, blocks: list[list[Burst]], caplog: pytest.LogCaptureFixture
) -> None:
    wire.error = struct.error("unpack requires a buffer of 4 bytes")
    link.start()
    until(lambda: wire.closed >= 3)
    assert link.state == "waiting: unpack requires a buffer of 4 bytes"
    told = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert len(told) == 1
    assert told[0].exc_info is not None
    wire.error = None
    until(lambda: len(blocks) > 0)
    assert link.state == "running"


def test_a_link_that_waits_ends_at_once(link: ImuLink, wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(imu_link, "FIRST_RETRY_S", 3600.0)
    monkeypatch.setattr(imu_link, "LONGEST_RETRY_S", 3600.0)
    wire.error = SpiError("the port is gone")
    link.start()
    until(lambda: link.state == "waiting: the port is gone")
    link.stop()
    assert not link._thread.is_alive()


@pytest.mark.parametrize(
    ("settings", "error", "said"),
    [
        ({"transport": "socket", "socket_path": "/nowhere/imu"}, SpiError, "start `ramstroke sim` first"),
        ({"transport": "spidev", "spi_device": "/dev/spidev9.9"}, SpiError, "/dev/spidev9.9"),
    ],
)
def test_a_port_that_is_not_there_is_named(settings: dict[str, str], error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        open_ports(ImuSettings.model_validate(settings), SystemClock(), None)


@pytest.mark.parametrize("kind", ["socket", "spidev"])
def test_a_port_is_closed_again_when_its_line_cannot_be_opened(
    kind: str, monkeypatch: pytest.MonkeyPatch, short_path: Path
) -> None:
    opened: list[Wire] = []

    def transport(_: str) -> Wire:
        opened.append(Wire(None))
        return opened[-1]

    def no_line(*_: object, **__: object) -> None:
        raise DataReadyError("no such line")

    monkeypatch.setattr(imu_link, "SpidevTransport", transport)
    monkeypatch.setattr(imu_link, "GpiodDataReady", no_line)
    monkeypatch.setattr("drivers.virtual.spi_socket.SocketTransport", transport)
    monkeypatch.setattr("drivers.virtual.spi_socket.SocketDataReady", no_line)
    settings = ImuSettings.model_validate({"transport": kind, "data_ready_line": 5})
    with pytest.raises(DataReadyError):
        open_ports(settings, SystemClock(), None)
    assert [wire.closed for wire in opened] == [1]


def test_without_a_line_a_real_part_is_read_at_its_nominal_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    wire = Wire(None)
    monkeypatch.setattr(imu_link, "SpidevTransport", lambda _: wire)

    class Stepping:
        """Time that passes by sleeping."""

        now = 0

        def now_ns(self) -> int:
            return self.now

        def sleep(self, seconds: float) -> None:
            self.now += round(seconds * 1e9)

    clock: Clock = Stepping()
    transport, line = open_ports(ImuSettings(), clock, None)
    assert transport is wire
    edges = [line.wait(1.0) for _ in range(820)]
    assert all(edge is not None for edge in edges)
    assert clock.now_ns() == pytest.approx(820 / 819.2 * 1e9, rel=1e-4)


def test_the_virtual_part_is_the_supports_own() -> None:
    support: VirtualSupport = virtual_support(SETTINGS, cycles=1)
    transport, line = open_ports(SETTINGS.imu, SystemClock(), support)
    line.close()
    transport.close()
