"""The daemon starts while the ram stands at 300 mm: what it claims, and how sure it says it is."""

from __future__ import annotations

import asyncio
import contextlib
import random
import time
from collections.abc import AsyncIterator
from math import hypot, sqrt
from pathlib import Path

import pytest

from daemon.service.application import Application
from daemon.service.state_file import SavedStroke, load, save
from daemon.settings import Settings
from daemon.simulation.virtual import virtual_part, virtual_support
from drivers.can.interface import to_message
from drivers.clock import SystemClock
from drivers.virtual.can_network import NetworkBus
from drivers.virtual.controller import VirtualController
from drivers.virtual.spi_socket import SpiSocketServer
from tests.daemon.application_kit import Viewer, run, settings_in

pytestmark = pytest.mark.usefixtures("unsettled_process")

STROKE_MM = 300.0
UNDETERMINED_MM = (250.0, 500 / sqrt(12))


def remember(settings: Settings, displacement_mm: float) -> None:
    saved = SavedStroke(
        wall_time_s=time.time(), stroke_mm=500, displacement_mm=displacement_mm, sigma_mm=2, at_rest=True
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
    assert viewer.of("event") == []
    # It is the new stroke that is remembered.
    remembered = load(settings.service.state_file, 500).displacement_m
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
    start = load(settings.service.state_file, 500)
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
