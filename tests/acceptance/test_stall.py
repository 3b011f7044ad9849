"""The daemon stands still for a while, its acquiring process does not: nothing is lost or comes too late."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import pytest

from daemon.offline.replaying.replay import replay
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import Health
from daemon.service.live_client import first_line
from drivers.adis16448.burst import Burst
from estimation.records import Event
from tests.acceptance.test_two_processes import PATIENCE_S, ended, started

STALL_S = 1.5


@pytest.fixture
def config(short_path: Path) -> Path:
    path = short_path / "stall.toml"
    path.write_text(
        '[imu]\ntransport = "virtual"\nacquisition = "process"\n'
        '[can]\ninterface = "virtual"\nchannel = "stall"\n'
        f'[recording]\ndirectory = "{short_path}/recordings"\nkeep_free_mb = 0\n'
        f'[service]\nsocket = "{short_path}/live"\nstate_file = "{short_path}/state.json"\n'
    )
    return path


def test_a_daemon_that_was_stopped_loses_no_sample_and_believes_them_all(config: Path, short_path: Path) -> None:
    with started("run", config) as run:
        deadline = time.monotonic() + PATIENCE_S
        while _samples(short_path / "live") < 3000 and time.monotonic() < deadline:
            time.sleep(0.1)
        os.kill(run.pid, signal.SIGSTOP)
        time.sleep(STALL_S)
        os.kill(run.pid, signal.SIGCONT)
        before = _samples(short_path / "live")
        while _samples(short_path / "live") < before + 2500 and time.monotonic() < deadline:
            time.sleep(0.1)
        ended(run, signal.SIGTERM)
    (path,) = (short_path / "recordings").iterdir()
    bursts: list[Burst] = []
    said: list[str] = []
    health: dict[str, dict[str, int]] = {}
    for _, record in Recording(path).messages((topics.IMU_RAW, topics.EVENTS, topics.HEALTH)):
        if isinstance(record, Burst):
            bursts.append(record)
        elif isinstance(record, Event):
            said.append(record.what)
        elif isinstance(record, Health):
            health = json.loads(record.json)
    assert health["estimator"]["late_samples"] == 0
    assert not any("silent" in what for what in said), said
    # Read in time by the other process, not all at once afterwards.
    span_s = (bursts[-1].t_ns - bursts[0].t_ns) * 1e-9
    assert len(bursts) + health["imu"]["missed"] > 0.96 * 819.2 * span_s
    assert health["imu"]["dropped"] == health["imu"]["process_restarts"] == 0
    assert replay(path).identical is True


def _samples(socket: Path) -> int:
    try:
        return int(first_line(socket)["estimator"]["samples"])
    except Exception:  # not there yet, or just stopped
        return 0
