"""The daemon starts while the ram stands at 300 mm: what it claims, how sure it says it is, what it still knows."""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import time
from collections.abc import AsyncIterator
from math import hypot, sqrt
from pathlib import Path

import pytest

from daemon.machine import machine_of
from daemon.offline.replaying.replay import replay
from daemon.recording import topics
from daemon.recording.metadata import LEARNED
from daemon.recording.reader import Recording
from daemon.recording.topics import Health
from daemon.service.application import Application
from daemon.service.state_file import SavedState, load, read, save
from daemon.settings import Settings
from daemon.simulation.virtual import virtual_part, virtual_support
from drivers.can.interface import to_message
from drivers.clock import SystemClock
from drivers.virtual.can_network import NetworkBus
from drivers.virtual.controller import VirtualController
from drivers.virtual.spi_socket import SpiSocketServer
from estimation.learned import Learned
from tests.daemon.application_kit import Viewer, run, settings_in
from tests.estimation.learned_kit import learned_of

pytestmark = pytest.mark.usefixtures("unsettled_process")

STROKE_MM = 300.0
UNDETERMINED_MM = (250.0, 500 / sqrt(12))


def remember(settings: Settings, displacement_mm: float, learned: Learned | None = None) -> None:
    saved = SavedState(
        wall_time_s=time.time(),
        stroke_mm=500,
        displacement_mm=displacement_mm,
        sigma_mm=2,
        at_rest=True,
        learned=learned,
    )
    save(settings.service.state_file, saved)


@contextlib.asynccontextmanager
async def controller_at_300(settings: Settings) -> AsyncIterator[None]:
    """Frames of a controller whose ram stands, 15 a second, with the noise that such sensors have."""

    async def send() -> None:
        noise = random.Random(5)
        readings = ((number, STROKE_MM / 1e3 + noise.gauss(0, 0.003)) for number in range(1_000_000))
        frames = VirtualController(readings, settings.can.displacement)
        with NetworkBus(settings.can.channel) as bus:
            for number in range(1_000_000):
                for frame in frames.due(number):
                    bus.send(to_message(frame))
                await asyncio.sleep(1 / 15)

    sending = asyncio.ensure_future(send())
    try:
        yield
    finally:
        sending.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await sending


def test_with_can_the_sensor_is_believed_against_the_saved_stroke(short_path: Path) -> None:
    path = str(short_path / "imu")
    settings = settings_in(
        short_path,
        imu={"transport": "socket", "socket_path": path},
        can={"reference": None, "publish": {"enabled": False}},
    )
    remember(settings, displacement_mm=120)
    clock = SystemClock()
    server = SpiSocketServer(path, virtual_part(virtual_support(settings, start_ns=clock.now_ns()), clock))
    server.start()
    viewer = Viewer(settings)

    async def scene() -> None:
        async with controller_at_300(settings):
            await viewer.read_until(lambda line: line.get("sigma_mm", 1e3) < 9)
            await viewer.read_until(lambda line: line["type"] == "status" and line["imu"]["samples"] > 300)

    try:
        run(Application(settings), scene)
    finally:
        server.close()
    estimates = viewer.of("estimate")
    assert all(abs(e["displacement_mm"] - STROKE_MM) < 4 * e["sigma_mm"] for e in estimates)
    last = estimates[-1]
    # By the settings' defaults: offset 1.5 mm, scale 1.8 %, bow 1.2 mm; and what noise is left.
    floor_mm = hypot(1.5, 0.018 * STROKE_MM, 1.2)
    assert 0.5 * floor_mm < last["sigma_mm"] < 1.6 * floor_mm
    assert last["can_state"] == "ok"
    # A computer that is busy with other tests may lose samples; of the displacement sensor nothing is to be told.
    assert [event["what"] for event in viewer.of("event") if "inertial" not in event["what"]] == []
    # It is the new stroke that is remembered.
    remembered = load(settings.service.state_file, settings).displacement_m
    assert remembered == pytest.approx(0.300, abs=0.02)


def test_without_can_the_saved_stroke_is_believed_with_doubt_added(short_path: Path) -> None:
    settings = settings_in(short_path, can={"enabled": False})
    remember(settings, displacement_mm=STROKE_MM)
    viewer = Viewer(settings)

    async def scene() -> None:
        told = await viewer.read_until(lambda line: line["type"] == "event")
        assert told["what"] == "no displacement reading: the saved stroke is believed"
        await viewer.read_until(lambda line: line["type"] == "estimate")

    run(Application(settings), scene)
    estimates = viewer.of("estimate")
    assert (estimates[0]["displacement_mm"], estimates[0]["sigma_mm"]) == pytest.approx(UNDETERMINED_MM, rel=1e-3)
    last = estimates[-1]
    assert last["displacement_mm"] == pytest.approx(STROKE_MM, abs=0.1)
    assert last["sigma_mm"] == pytest.approx(hypot(2, 5), rel=0.01)
    # At every restart the doubt of an unwatched ram is added once more.
    start = load(settings.service.state_file, settings)
    assert start.displacement_m == pytest.approx(STROKE_MM / 1e3, abs=1e-4)
    assert start.sigma_m * 1e3 == pytest.approx(hypot(2, 5, 5), rel=0.02)


def test_with_neither_the_stroke_is_undetermined(short_path: Path) -> None:
    settings = settings_in(short_path, can={"enabled": False})
    viewer = Viewer(settings)

    async def scene() -> None:
        await viewer.read_until(lambda line: line["type"] == "estimate")
        await viewer.read_until(lambda line: line["type"] == "status" and line["imu"]["samples"] > 300)

    run(Application(settings), scene)
    for estimate in viewer.of("estimate"):
        claimed = estimate["displacement_mm"], estimate["sigma_mm"]
        assert claimed == pytest.approx(UNDETERMINED_MM, rel=1e-3)


def test_what_was_learned_outlasts_restarts_and_stands_in_every_recording(short_path: Path) -> None:
    settings = settings_in(short_path, can={"enabled": False})
    before = learned_of(machine_of(settings))
    remember(settings, STROKE_MM, before)
    for _ in range(2):
        viewer = Viewer(settings)

        async def scene(viewer: Viewer = viewer) -> None:
            await viewer.read_until(lambda line: line["type"] == "estimate")
            await viewer.read_until(lambda line: line["type"] == "status")

        run(Application(settings), scene)
        (greeting,) = viewer.of("hello")
        assert greeting["learned"]["push"] == pytest.approx(
            {
                "speed_mm_s": before.push.speed_m_s * 1e3,
                "sigma_mm_s": before.push.sigma_m_s * 1e3,
                "moves": before.pushes,
            },
            abs=1e-4,
        )
    # The seconds between are nothing to months of memory, and nobody moved the ram.
    after = read(settings.service.state_file, settings).learned
    assert after is not None
    assert (after.pushes, after.retracts, after.noise_m) == (before.pushes, before.retracts, before.noise_m)
    assert after.machine.displacement_signal == before.machine.displacement_signal
    assert after.machine.inertial_part.startswith("ADIS16448 lot ")
    for name in after.names:
        assert after.value(name) == pytest.approx(before.value(name), rel=1e-3)

    files = sorted(settings.recording.directory.iterdir())
    assert len(files) == 2
    for path in files:
        assert replay(path).identical is True
        recorded = Learned.model_validate_json(Recording(path).attachments[LEARNED])
        assert recorded.push == pytest.approx(before.push, rel=1e-3)
        healths = [r for _, r in Recording(path).messages((topics.HEALTH,)) if isinstance(r, Health)]
        assert json.loads(healths[-1].json)["learned"]["sensor"]["calibrations"] == before.calibrations


def test_what_was_learned_of_another_machine_is_refused_as_a_whole(
    short_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    settings = settings_in(short_path, can={"enabled": False})
    elsewhere = machine_of(settings).model_copy(update={"push_speed_m_s": 0.02})
    remember(settings, STROKE_MM, learned_of(elsewhere))
    refusing = Application(settings)
    assert [line for line in caplog.messages if "state.json" in line] == [
        f"{settings.service.state_file} cannot be used: learned on another machine (its nominal push speed is "
        "20 mm/s, not 14.53 mm/s): the stroke is undetermined and nothing is learned yet"
    ]
    viewer = Viewer(settings)

    async def scene() -> None:
        await viewer.read_until(lambda line: line["type"] == "estimate")

    run(refusing, scene)
    assert viewer.of("hello")[0]["learned"] is None
    assert viewer.of("estimate")[-1]["sigma_mm"] == pytest.approx(UNDETERMINED_MM[1], rel=1e-3)
