"""The thread that reads for ever."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.acquisition import Acquisition, Block
from drivers.adis16448.burst import Burst
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.machine import InertialSensor
from drivers.clock import SystemClock
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.inertial_input import SteadyInput
from drivers.virtual.sensor_errors import SensorErrors
from estimation.records import TimeKind

PATIENCE_S = 20.0


class Numbers:
    """A sensor that counts."""

    def __init__(self) -> None:
        self.reads = 0
        self.is_closed = False
        self.thread = ""

    def read_block(self) -> Block:
        self.thread = threading.current_thread().name
        self.reads += 1
        return [Burst(self.reads, TimeKind.READ, (0,) * 12, None)] if self.reads % 2 else []

    def close(self) -> None:
        self.is_closed = True


class Sink:
    """Takes blocks until there are enough."""

    def __init__(self, enough: int, harm: Callable[[int], None] = lambda _: None) -> None:
        self.blocks: list[Block] = []
        self.is_full = threading.Event()
        self._enough = enough
        self._harm = harm

    def __call__(self, block: Block) -> None:
        self.blocks.append(block)
        if len(self.blocks) >= self._enough:
            self.is_full.set()
        self._harm(len(self.blocks))


def run(sensor: Any, sink: Sink, **options: Any) -> Acquisition:
    acquisition = Acquisition(sensor, sink, **options)
    acquisition.start()
    assert sink.is_full.wait(PATIENCE_S)
    acquisition.stop()
    assert not acquisition.is_running
    return acquisition


def test_every_block_is_handed_over_in_order_until_the_stop_and_the_ports_are_closed() -> None:
    sensor, sink = Numbers(), Sink(50)
    run(sensor, sink)
    handed_over = len(sink.blocks)
    assert [item.t_ns for block in sink.blocks for item in block] == list(range(1, 2 * handed_over, 2))
    assert sensor.thread == "acquisition"
    assert sensor.is_closed
    assert len(sink.blocks) == handed_over


def test_a_receiver_that_fails_costs_its_blocks_only_and_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    def harm(number: int) -> None:
        if number <= 3:
            raise ValueError("not now")

    sink = Sink(10, harm)
    acquisition = run(Numbers(), sink)
    assert acquisition.lost_blocks == 3
    assert sum(record.exc_info is not None for record in caplog.records) == 1


def test_a_priority_that_the_system_refuses_is_told_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with caplog.at_level(logging.WARNING):
        run(Numbers(), Sink(3), realtime_priority=50)
    (line,) = caplog.messages
    assert "LimitRTPRIO=50" in line
    assert "CAP_SYS_NICE" in line


def test_a_priority_is_that_of_the_acquiring_thread_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, int, int, int]] = []

    def accept(pid: int, policy: int, param: os.sched_param) -> None:
        asked.append((threading.current_thread().name, pid, policy, param.sched_priority))

    monkeypatch.setattr(os, "sched_setscheduler", accept)
    run(Numbers(), Sink(1))
    assert asked == []
    run(Numbers(), Sink(1), realtime_priority=50)
    assert asked == [("acquisition", 0, os.SCHED_FIFO, 50)]


def test_stopping_what_was_never_started_is_fine() -> None:
    Acquisition(Numbers(), lambda _: None).stop()


def test_the_sensor_runs_on_the_system_clock_as_on_a_virtual_one() -> None:
    clock = SystemClock()
    # Without noise it would look frozen.
    errors = SensorErrors(np.random.default_rng(1))
    part = VirtualAdis16448(SteadyInput(start_ns=clock.now_ns()), clock, errors=errors)
    sensor = InertialSensor(ImuSettings(), clock, lambda: part, part.data_ready)
    sink = Sink(20)
    run(sensor, sink)
    items = [item for block in sink.blocks for item in block]
    bursts = items[1:]
    assert items[0] == sensor.identity
    assert all(isinstance(item, Burst) for item in bursts)
    assert [item.t_ns for item in items] == sorted(item.t_ns for item in items)
    counters = sensor.counters
    waiting = sensor._timer.skip()
    # No longer read, the part goes on: its edges only grow between the two looks.
    total = counters.edge_reads + counters.missed + counters.missed_starting + counters.unheeded + waiting
    assert total <= part.account().edges
    assert part.account().edges - total < 800
    assert counters.samples == len(bursts)
