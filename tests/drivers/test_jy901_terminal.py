"""The virtual JY901 on a pseudo-terminal, read by pyserial as a real one is, in real time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.condition import Wellness
from drivers.jy901.machine import Jy901
from drivers.jy901.port import PortError, PySerialPort
from drivers.jy901.reading import Reading
from drivers.virtual.faults import FaultScript
from drivers.virtual.inertial_input import SteadyInput
from drivers.virtual.jy901 import VirtualJy901
from drivers.virtual.jy901_line import VirtualLine
from drivers.virtual.jy901_terminal import SerialTerminal
from drivers.virtual.sensor_errors import JY901, SensorErrors
from tests.drivers.jy901_kit import settings

PATIENCE_S = 30.0


class Served:
    def __init__(self, folder: Path, *faults: dict[str, Any]) -> None:
        self.path = folder / "jy901"
        start_ns = SystemClock().now_ns()
        self.line = VirtualLine(
            VirtualJy901(SteadyInput(start_ns=start_ns), start_ns, SensorErrors(np.random.default_rng(1), JY901)),
            FaultScript.model_validate({"fault": faults}),
            start_ns,
        )
        self.terminal = SerialTerminal(str(self.path), self.line, SystemClock())
        self.sensor = Jy901(settings(), SystemClock(), lambda: PySerialPort(str(self.path)))
        self.readings: list[Reading] = []

    def until(self, reached: Callable[[], bool]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not reached():
            assert time.monotonic() < end_s, self.sensor.condition
            self.readings += [one for one in self.sensor.read_block() if isinstance(one, Reading)]


@contextmanager
def served(folder: Path, *faults: dict[str, Any]) -> Iterator[Served]:
    made = Served(folder, *faults)
    made.terminal.start()
    try:
        yield made
    finally:
        made.sensor.close()
        made.terminal.close()


def test_samples_come_through_a_terminal(short_path: Path) -> None:
    with served(short_path) as bench:
        bench.until(lambda: len(bench.readings) >= 300)
        assert bench.sensor.condition.word in (Wellness.OK, Wellness.ILL)  # a busy computer may be too late for some
        assert (bench.sensor.counters.port_failures, bench.sensor.counters.starts) == (0, 1)
        assert bench.line.part.baud == 115200
        up = np.mean([one.sample().accel[2] for one in bench.readings])
        assert up == pytest.approx(9.8, abs=0.4)  # a part with 10 mg of bias
    assert not os.path.lexists(bench.path)


def test_an_adapter_pulled_out_and_plugged_in_again(short_path: Path) -> None:
    with served(short_path, {"kind": "adapter_gone", "at_s": 2.0, "for_s": 1.0}) as bench:
        bench.until(lambda: len(bench.readings) >= 50)
        bench.until(lambda: bench.sensor.condition.word is Wellness.WAITING)
        assert str(bench.path) in bench.sensor.condition.what
        count = len(bench.readings)
        bench.until(lambda: len(bench.readings) >= count + 50)
        assert bench.sensor.counters.port_failures >= 1
        assert bench.sensor.counters.errors == 0


def test_nobody_reads_and_then_somebody_does(short_path: Path) -> None:
    """What nobody reads is gone, as on a real line; whoever opens the port then gets fresh samples."""
    with served(short_path) as bench:
        time.sleep(1.5)
        bench.until(lambda: len(bench.readings) >= 20)
        assert time.monotonic_ns() - bench.readings[-1].t_ns < 1e9


def test_a_file_of_that_name_is_not_overwritten(short_path: Path) -> None:
    (short_path / "jy901").write_text("precious")
    with pytest.raises(PortError, match="is there already and none of ours: name another port in"):
        Served(short_path).terminal.start()
    assert (short_path / "jy901").read_text() == "precious"


@pytest.mark.parametrize("path", ["/dev/null", "/no/such/port", "/tmp"])
def test_what_is_no_serial_port_is_one_sentence(path: str) -> None:
    with pytest.raises(PortError, match=f"cannot open the serial port {path}: "):
        PySerialPort(path)
