"""A JY901 driver and its twin on a virtual line, in simulated time."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any, TypeVar

import numpy as np

from drivers.clock import VirtualClock
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.machine import Jy901
from drivers.jy901.packets import BAUD, BAUD_CODES
from drivers.jy901.reading import Reading
from drivers.jy901.settings import Jy901Settings
from drivers.virtual.faults import FaultScript
from drivers.virtual.inertial_input import RecordedInput
from drivers.virtual.jy901 import VirtualJy901
from drivers.virtual.jy901_line import VirtualLine
from drivers.virtual.jy901_port import VirtualSerialPort

T = TypeVar("T")
STEPS = np.array([0.01, 0.013, 0.017])
MOTION_NS = 1_250_000


def motion(seconds: float = 60.0) -> RecordedInput:
    """Every value another; 800 samples a second."""
    n = round(seconds * 800)
    t_ns = (np.arange(n) * MOTION_NS).astype(np.int64)
    wave = np.sin(np.arange(n)[:, None] * STEPS)
    return RecordedInput(t_ns, 2.0 * wave, 9.0 * wave + np.array([0, 0, 9.8]), 31.0)


def settings(**chosen: Any) -> Jy901Settings:
    return Jy901Settings.model_validate({"use": "instead"} | chosen)


class Bench:
    """Driver, line and part."""

    def __init__(
        self,
        *faults: dict[str, Any],
        seconds: float = 60.0,
        found_at: int = 9600,
        old: bool = False,
        **chosen: Any,
    ) -> None:
        self.clock = VirtualClock()
        self.settings = settings(**chosen)
        self.part = VirtualJy901(motion(seconds), has_old_firmware=old)
        self.part.registers[BAUD] = self.part.saved[BAUD] = BAUD_CODES[found_at]
        script = FaultScript.model_validate({"fault": faults})
        self.line = VirtualLine(self.part, script)
        self.opened = 0
        self.sensor = Jy901(self.settings, self.clock, self.open)
        self.readings: list[Reading] = []
        self.identities: list[Jy901Identity] = []

    def open(self) -> VirtualSerialPort:
        self.opened += 1
        return VirtualSerialPort(self.line, self.clock)

    @property
    def now_s(self) -> float:
        return self.clock.now_ns() * 1e-9

    def run(self, until_s: float) -> None:
        while self.now_s < until_s:
            for item in self.sensor.read_block():
                (self.readings if isinstance(item, Reading) else self.identities).append(item)  # type: ignore[arg-type]  # by kind

    def port(self, baudrate: int = 115200) -> VirtualSerialPort:
        port = self.open()
        port.baudrate = baudrate
        return port

    def between(self, from_s: float, to_s: float) -> list[Reading]:
        return [one for one in self.readings if from_s * 1e9 <= one.t_ns < to_s * 1e9]


def finished(work: Generator[None, None, T]) -> T:
    """What a generator that waits now and then comes to."""
    try:
        while True:
            next(work)
    except StopIteration as done:
        value: T = done.value
        return value
