"""The kernel's SPI port and GPIO line, with the modules that reach them replaced by fakes."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import pytest

from drivers.data_ready import DataReadyError, Edge, GpiodDataReady
from drivers.spi import SpidevTransport, SpiError
from estimation.records import TimeKind


class FakeSpiDev:
    opened: ClassVar[list[FakeSpiDev]] = []
    open_error: ClassVar[OSError | None] = None

    def __init__(self) -> None:
        self.mode = self.bits_per_word = 0
        self.path = ""
        self.calls: list[tuple[list[int], int]] = []
        self.is_open = False
        self.error: OSError | None = None

    def open_path(self, path: str) -> None:
        if FakeSpiDev.open_error is not None:
            raise FakeSpiDev.open_error
        self.path, self.is_open = path, True
        FakeSpiDev.opened.append(self)

    def xfer2(self, values: list[int], speed_hz: int) -> list[int]:
        if self.error is not None:
            raise self.error
        self.calls.append((values, speed_hz))
        return [value ^ 0xFF for value in values]

    def close(self) -> None:
        self.is_open = False


@pytest.fixture
def spidev(monkeypatch: pytest.MonkeyPatch) -> type[FakeSpiDev]:
    module: Any = ModuleType("spidev")
    module.SpiDev = FakeSpiDev
    monkeypatch.setitem(sys.modules, "spidev", module)
    monkeypatch.setattr(FakeSpiDev, "opened", [])
    monkeypatch.setattr(FakeSpiDev, "open_error", None)
    return FakeSpiDev


def test_spidev_exchanges_one_frame_in_mode_three_with_eight_bit_words(spidev: type[FakeSpiDev]) -> None:
    transport = SpidevTransport("/dev/spidev1.2")
    assert transport.transfer(b"\x56\x00", 1_000_000) == b"\xa9\xff"
    (port,) = spidev.opened
    assert (port.path, port.mode, port.bits_per_word) == ("/dev/spidev1.2", 3, 8)
    assert port.calls == [([0x56, 0x00], 1_000_000)]
    transport.close()
    assert not port.is_open


def test_a_missing_spidev_module_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "spidev", None)
    with pytest.raises(SpiError, match=r"install ramstroke\[hardware\]"):
        SpidevTransport()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (FileNotFoundError(2, "No such file"), "there is no SPI port /dev/spidev0.0"),
        (PermissionError(13, "denied"), "no permission to open the SPI port /dev/spidev0.0"),
        (OSError(16, "busy"), "cannot open the SPI port /dev/spidev0.0"),
    ],
)
def test_a_port_that_does_not_open_is_named(
    spidev: type[FakeSpiDev], monkeypatch: pytest.MonkeyPatch, error: OSError, words: str
) -> None:
    monkeypatch.setattr(FakeSpiDev, "open_error", error)
    with pytest.raises(SpiError, match=words):
        SpidevTransport()


def test_a_failed_transfer_names_the_port(spidev: type[FakeSpiDev]) -> None:
    transport = SpidevTransport()
    spidev.opened[0].error = OSError(5, "I/O error")
    with pytest.raises(SpiError, match=r"SPI transfer on /dev/spidev0.0 failed"):
        transport.transfer(b"\0\0", 1)


@dataclass
class FakeLines:
    """What gpiod.request_lines returns: a queue of events."""

    events: list[Any] = field(default_factory=list)
    error: OSError | None = None
    released: bool = False
    timeouts: list[float] = field(default_factory=list)

    def wait_edge_events(self, timeout: float) -> bool:
        if self.error is not None:
            raise self.error
        self.timeouts.append(timeout)
        return bool(self.events)

    def read_edge_events(self) -> list[Any]:
        events, self.events = self.events, []
        return events

    def release(self) -> None:
        self.released = True


def event(t_ns: int, line_seqno: int) -> Any:
    return SimpleNamespace(timestamp_ns=t_ns, line_seqno=line_seqno)


@pytest.fixture
def gpiod(monkeypatch: pytest.MonkeyPatch) -> Any:
    module: Any = ModuleType("gpiod")
    line: Any = ModuleType("gpiod.line")
    line.Clock = SimpleNamespace(MONOTONIC="monotonic")
    line.Direction = SimpleNamespace(INPUT="input")
    line.Edge = SimpleNamespace(RISING="rising", FALLING="falling")
    module.line = line
    module.LineSettings = lambda **settings: settings
    module.requests = []
    module.lines = FakeLines()
    module.refusal = None

    def request_lines(path: str, **options: Any) -> FakeLines:
        if module.refusal is not None:
            raise module.refusal
        module.requests.append((path, options))
        lines: FakeLines = module.lines
        return lines

    module.request_lines = request_lines
    monkeypatch.setitem(sys.modules, "gpiod", module)
    monkeypatch.setitem(sys.modules, "gpiod.line", line)
    return module


@pytest.mark.parametrize(("active_high", "edge"), [(True, "rising"), (False, "falling")])
def test_the_line_is_an_input_with_kernel_stamps_of_the_edge_to_valid_data(
    gpiod: Any, active_high: bool, edge: str
) -> None:
    line = GpiodDataReady("/dev/gpiochip3", 17, active_high=active_high)
    ((path, options),) = gpiod.requests
    assert path == "/dev/gpiochip3"
    assert options["config"] == {17: {"direction": "input", "edge_detection": edge, "event_clock": "monotonic"}}
    line.close()
    assert gpiod.lines.released


def test_only_the_newest_queued_edge_counts_and_the_rest_are_missed(gpiod: Any) -> None:
    line = GpiodDataReady("/dev/gpiochip0", 1)
    gpiod.lines.events = [event(100, 7)]
    assert line.wait(0.5) == Edge(100, TimeKind.EDGE, 6)  # the kernel counts from the opening of the line
    assert gpiod.lines.timeouts == [0.5]
    gpiod.lines.events = [event(200, 8), event(300, 9), event(400, 10)]
    assert line.wait(0.5) == Edge(400, TimeKind.EDGE, 2)
    gpiod.lines.events = [event(900, 15)]  # four dropped by the kernel
    assert line.wait(0.5) == Edge(900, TimeKind.EDGE, 4)
    assert line.wait(0.5) is None


def test_a_missing_gpiod_module_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gpiod", None)
    with pytest.raises(DataReadyError, match=r"install ramstroke\[hardware\]"):
        GpiodDataReady("/dev/gpiochip0", 1)


def test_a_line_that_cannot_be_had_or_read_is_named(gpiod: Any) -> None:
    gpiod.refusal = OSError(16, "busy")
    with pytest.raises(DataReadyError, match=r"cannot watch line 5 of /dev/gpiochip0 .*busy"):
        GpiodDataReady("/dev/gpiochip0", 5)
    gpiod.refusal = None
    line = GpiodDataReady("/dev/gpiochip0", 5)
    gpiod.lines.error = OSError(19, "no such device")
    with pytest.raises(DataReadyError, match="cannot read line 5 of /dev/gpiochip0"):
        line.wait(1.0)


def test_the_number_of_an_edge_may_run_over(gpiod: Any) -> None:
    line = GpiodDataReady("/dev/gpiochip0", 1)
    gpiod.lines.events = [event(100, 0xFFFF_FFFE)]
    line.wait(0.5)
    gpiod.lines.events = [event(200, 1)]
    assert line.wait(0.5) == Edge(200, TimeKind.EDGE, 2)
