"""A sensor on a virtual part in simulated time, with a wire between them that tests can harm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivers.adis16448.burst import Burst, Fault
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.device import Adis16448
from drivers.adis16448.identity import Identity
from drivers.adis16448.machine import InertialSensor, State
from drivers.clock import Clock, VirtualClock
from drivers.data_ready import DataReady, DataReadyError, Edge
from drivers.spi import SpiError
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.adis16448_line import Arrival
from drivers.virtual.inertial_input import InertialInput, SteadyInput
from drivers.virtual.sensor_errors import SensorErrors

SECOND = 1_000_000_000
RATE_HZ = 800.0
BURST_BYTES = (26, 28)


def bring_up(device: Adis16448, clock: Clock) -> Identity:
    """Reset, identify, test and configure a part that is well."""
    device.reset()
    clock.sleep(0.09)
    identity = device.identify()
    device.begin_self_test()
    clock.sleep(0.045 * (1 << device.settings.decimation_exponent))
    assert device.self_test_verdict() is not None
    device.configure()
    return identity


@dataclass
class Wire:
    """An SPI port that passes frames on, or what a test makes of them."""

    part: VirtualAdis16448
    tamper: Callable[[bytes, bytes], bytes] = lambda _, answer: answer
    error: str = ""  # every transfer fails with it
    open_error: str = ""
    opened: int = 0
    closed: int = 0
    frames: list[tuple[int, bytes]] = field(default_factory=list)

    def open(self) -> Wire:
        if self.open_error:
            raise SpiError(self.open_error)
        self.opened += 1
        return self

    def transfer(self, data: bytes, speed_hz: int) -> bytes:
        if self.error:
            raise SpiError(self.error)
        if len(data) == 2:
            self.frames.append((self.part.clock.now_ns(), data))
        return self.tamper(data, self.part.transfer(data, speed_hz))

    def close(self) -> None:
        self.closed += 1

    def sent(self, word: int) -> list[int]:
        """Times at which that word was sent."""
        return [t_ns for t_ns, data in self.frames if data == word.to_bytes(2, "big")]


@dataclass
class Line:
    """A data-ready line that can fail, and may add edges."""

    inner: DataReady
    error: str = ""
    closed: int = 0
    extra: list[Edge] = field(default_factory=list)

    def wait(self, timeout_s: float) -> Edge | None:
        if self.error:
            raise DataReadyError(self.error)
        return self.extra.pop(0) if self.extra else self.inner.wait(timeout_s)

    def close(self) -> None:
        self.closed += 1


@dataclass
class Lossy:
    """A wire that loses edges at random, by their share."""

    share: float

    def arrivals(self, edge_ns: int) -> Sequence[Arrival]:
        is_lost = np.random.default_rng(edge_ns).random() < self.share
        return () if is_lost else (Arrival(edge_ns, edge_ns),)


class Bench:
    """Sensor, wire, line and part."""

    def __init__(
        self, imu: dict[str, Any] | None = None, source: InertialInput | None = None, *, line: bool = True, **part: Any
    ) -> None:
        self.clock = VirtualClock()
        part.setdefault("errors", SensorErrors(np.random.default_rng(1)))
        self.part = VirtualAdis16448(source or SteadyInput(RATE_HZ), self.clock, **part)
        self.wire = Wire(self.part)
        self.settings = ImuSettings.model_validate(imu or {})
        self.line_error = ""
        self.lines: list[Line] = []
        self.sensor = InertialSensor(self.settings, self.clock, self.wire.open, self.open_line if line else None)
        self.longest_call_s = 0.0

    def open_line(self) -> Line:
        if self.line_error:
            raise DataReadyError(self.line_error)
        # At the end of a wire that inverts where the settings say so: the kernel stamps the pin's own rising edge.
        self.lines.append(Line(self.part.data_ready(pin=self.settings.data_ready_pin)))
        return self.lines[-1]

    def step(self) -> list[Burst | Identity]:
        before_ns = self.clock.now_ns()
        items = self.sensor.read_block()
        self.longest_call_s = max(self.longest_call_s, (self.clock.now_ns() - before_ns) / 1e9)
        return items

    def run(self, seconds: float) -> list[Burst | Identity]:
        end_ns = self.clock.now_ns() + round(seconds * 1e9)
        items: list[Burst | Identity] = []
        while self.clock.now_ns() < end_ns:
            items += self.step()
        return items

    def run_to(self, state: State, limit_s: float = 20.0) -> list[Burst | Identity]:
        end_ns = self.clock.now_ns() + round(limit_s * 1e9)
        items: list[Burst | Identity] = []
        while self.sensor.state is not state:
            assert self.clock.now_ns() < end_ns, self.sensor.condition
            items += self.step()
        return items


def bursts(items: list[Burst | Identity]) -> list[Burst]:
    return [item for item in items if isinstance(item, Burst)]


def good(items: list[Burst | Identity]) -> list[Burst]:
    return [burst for burst in bursts(items) if burst.fault is Fault.NONE]


def identities(items: list[Burst | Identity]) -> list[Identity]:
    return [item for item in items if isinstance(item, Identity)]


def on_bursts(change: Callable[[bytes], bytes]) -> Callable[[bytes, bytes], bytes]:
    """Harm bursts only, registers stay readable."""
    return lambda data, answer: change(answer) if len(data) in BURST_BYTES else answer


def flip_bit(frame: bytes) -> bytes:
    """One wrong bit in the x gyro word."""
    return frame[:5] + bytes([frame[5] ^ 0x10]) + frame[6:]
