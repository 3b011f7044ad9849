"""Driver and bus in simulated time."""

from __future__ import annotations

from typing import Any

import pytest

from daemon.settings import Settings
from daemon.simulation.run import Devices, SimulatedRun
from daemon.simulation.virtual import virtual_support
from drivers.adis16448.burst import Burst
from drivers.clock import VirtualClock
from drivers.condition import OK, Wellness

SETTINGS = Settings.model_validate(
    {"imu": {"transport": "virtual"}, "can": {"interface": "virtual", "channel": "test-simulated-run"}}
)


def played(harm: Any = lambda _part: None) -> tuple[SimulatedRun, list[Any], int]:
    clock = VirtualClock()
    support = virtual_support(SETTINGS, cycles=1)
    devices = Devices.of(SETTINGS, support, clock)
    run = SimulatedRun(SETTINGS, devices, clock)
    assert run.identity is None
    harm(devices.part)
    items: list[Any] = []
    frames = 0
    while (received := run.next()) is not None:
        items += received[0]
        frames += len(received[1])
    run.close()
    assert clock.now_ns() == pytest.approx(support.truth().t_s[-1] * 1e9, rel=0.05)
    return run, items, frames


def test_a_whole_cycle_comes_with_identity_samples_and_frames() -> None:
    run, items, frames = played()
    assert items[0] == run.identity
    assert all(isinstance(item, Burst) for item in items[1:])
    assert run.sensor.counters.samples == len(items) - 1
    assert run.sensor.condition == OK
    assert run.bus is not None
    assert run.bus.counters.received == frames > 100


def test_a_part_that_is_broken_from_the_start_ends_the_run_at_its_time_with_a_reason() -> None:
    def harm(part: Any) -> None:
        part.stuck_byte = 0x00
        part.is_line_cut = True

    run, items, frames = played(harm)
    assert items == []
    assert frames > 100
    assert run.identity is None
    assert run.sensor.condition.word is Wellness.WAITING
    assert "0x0000 instead of 0x4040" in run.sensor.condition.what
