"""Recorded register words and CAN frames through the real driver, compared with the stored outcome.

Not a replay of what the driver once made of them: sensor and bus do again what they did, and the driver reads, judges,
counts, starts anew and says what is wrong. `make rebase` stores a new outcome.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from daemon.offline.replaying.replay import settings_of
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import Recorded
from daemon.service.health import kind_of
from daemon.settings import Settings
from daemon.simulation.run import Devices, SimulatedRun
from daemon.simulation.stream import SimulatedStream
from drivers.adis16448.identity import Identity
from drivers.clock import VirtualClock
from estimation.pipeline import Start
from estimation.records import Estimate, Event, Move
from tests.acceptance.test_regression import EVERY, RECORDINGS, assert_same
from tests.recorded_devices import devices_of, first_ns

START_UP_NS = 200_000_000  # the driver begins so long before the first recorded sample


def _outcome(path: Path) -> str:
    """What the driver met, counted and said, and every tenth settled step."""
    told: list[str] = []
    rows: list[str] = []
    settled = 0

    def receive(topic: str, record: Recorded) -> None:
        nonlocal settled
        if isinstance(record, Event):
            told.append(f"event {record.t_ns * 1e-9:.3f} {record.what}")
        elif isinstance(record, Move):
            told.append(f"move {record.number} {record.kind} {record.onset_ns * 1e-9:.3f} {record.stop_ns * 1e-9:.3f}")
        elif isinstance(record, Identity):
            told.append(f"sensor {record.t_ns * 1e-9:.3f} serial {record.serial}")
        elif topic == topics.SETTLED and isinstance(record, Estimate):
            if settled % EVERY == 0:
                words = f"{record.segment},{record.can_state}"
                numbers = f"{record.displacement_m * 1e3:.4f},{record.sigma_m * 1e3:.4f}"
                rows.append(f"{record.t_ns * 1e-9:.3f},{numbers},{words}")
            settled += 1

    clock = VirtualClock(max(0, first_ns(path) - START_UP_NS))
    settings = _on_virtual_devices(settings_of(Recording(path)), path.stem)
    part, controller = devices_of(path, clock)
    run = SimulatedRun(settings, Devices(controller, part), clock)
    with SimulatedStream(settings, run, clock, receive, Start()) as scene:
        bus, (decoder, *_) = scene.run.bus, scene.stream.decoders
        assert bus is not None
        conditions: dict[str, Any] = {}
        while scene.step():
            now_ns = clock.now_ns()
            for name, condition in (
                ("imu", scene.run.sensor.condition),
                ("can", bus.condition),
                ("displacement", decoder.report(now_ns).condition),
            ):
                if conditions.get(name) != kind_of(condition):
                    conditions[name] = kind_of(condition)
                    told.append(f"{name} {now_ns * 1e-9:.3f} {condition.word} {condition.what}".rstrip())
        scene.stream.finish()
        counted = asdict(scene.run.sensor.counters) | bus.report() | decoder.report(clock.now_ns()).counters()
    counts = [f"counted {name} {value}" for name, value in _flat(counted).items() if value]
    return "\n".join(
        [*(f"# {line}" for line in told + counts), "t_s,displacement_mm,sigma_mm,segment,can_state", *rows, ""]
    )


def _flat(counted: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in counted.items():
        if isinstance(value, dict):
            flat |= {f"{name} {key}": count for key, count in value.items()}
        elif isinstance(value, int) and not isinstance(value, bool):
            flat[name] = value
    return flat


def _on_virtual_devices(settings: Settings, channel: str) -> Settings:
    tree = settings.model_dump(mode="json")
    tree["imu"]["transport"] = "virtual"
    tree["can"] |= {"interface": "virtual", "channel": channel}
    return Settings.model_validate(tree)


@pytest.mark.parametrize("recording", RECORDINGS, ids=lambda path: path.stem)
def test_the_driver_makes_of_recorded_bytes_what_it_made_before(
    recording: Path, request: pytest.FixtureRequest
) -> None:
    assert_same(_outcome(recording), recording.with_suffix(".driver.csv"), request)
