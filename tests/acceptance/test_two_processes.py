"""`ramstroke sim` and `ramstroke run` as two programs: the sensor on a Unix socket, CAN on UDP multicast."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import can
import cantools.database
import pytest
from cantools.database.can import Database

from daemon.cli import main
from daemon.configuration import load
from daemon.offline.replaying.replay import replay
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import Health
from drivers.can.checksums import crc8_j1850
from drivers.can.frame import Frame
from drivers.can.presets import DBC_FOLDER

PATIENCE_S = 60.0
FRAMES = 60  # ten a second
GROUP = "239.74.163.77"


@pytest.fixture
def config(short_path: Path) -> Path:
    path = short_path / "trial.toml"
    path.write_text(
        f'[imu]\ntransport = "socket"\nsocket_path = "{short_path}/imu"\n'
        f'[can]\ninterface = "udp_multicast"\nchannel = "{GROUP}"\n'
        f"port = {random.SystemRandom().randrange(20_000, 60_000)}\nlisten_only = false\n"
        '[can.reference]\nmessage = "LaboratorySensor"\nsignal = "reference_stroke"\n'
        "[can.publish]\nenabled = true\n"
        f'[recording]\ndirectory = "{short_path}/recordings"\nkeep_free_mb = 0\n'
        f'[service]\nsocket = "{short_path}/live"\nstate_file = "{short_path}/state.json"\n'
        "[simulation]\nseed = 4\n"
    )
    return path


@contextmanager
def started(command: str, config: Path, *more: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "daemon.cli", command, "--config", str(config), *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def ended(process: subprocess.Popen[str], number: signal.Signals) -> str:
    """Send the signal; what the program said until its end."""
    process.send_signal(number)
    out, said = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out) == (0, ""), said
    assert "Traceback" not in said
    return said


def estimates_on(bus: can.BusABC, count: int) -> list[can.Message]:
    """Estimate frames as a third party on the bus sees them."""
    frames: list[can.Message] = []
    deadline = time.monotonic() + PATIENCE_S
    while len(frames) < count:
        assert time.monotonic() < deadline, f"{len(frames)} estimate frames"
        message = bus.recv(1.0)
        if message is not None and message.arbitration_id == 0x6F0:
            frames.append(message)
    return frames


def decoded(message: can.Message) -> dict[str, float]:
    """The estimate as a receiver reads it with the DBC file, by names alone."""
    database = cantools.database.load_file(DBC_FOLDER / "ramstroke_estimate.dbc", database_format="dbc")
    assert isinstance(database, Database)
    values = database.decode_message(message.arbitration_id, bytes(message.data), decode_choices=False)
    assert isinstance(values, dict)
    return {name: float(value) for name, value in values.items() if isinstance(value, int | float)}


def test_samples_frames_and_estimates_go_between_two_programs(
    config: Path, capsys: pytest.CaptureFixture[str], record_property: Callable[[str, object], None]
) -> None:
    port = load(config).can.port
    with ExitStack() as stack:
        third = stack.enter_context(can.Bus(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0))
        # The daemon first: it waits for its sensor.
        run = stack.enter_context(started("run", config))
        sim = stack.enter_context(started("sim", config))
        frames = estimates_on(third, FRAMES)
        assert main(["status", "--config", str(config), "--json"]) == 0
        status: dict[str, Any] = json.loads(capsys.readouterr().out)
        said = ended(run, signal.SIGTERM)
        ended(sim, signal.SIGINT)
    assert "inertial sensor: serial 1234 is running" in said
    assert not (config.parent / "imu").exists()
    assert not (config.parent / "live").exists()

    # A computer that is busy with other tests may miss samples.
    assert status["imu"]["state"] in ("ok", "ill")
    assert status["can"]["state"] == status["recorder"]["state"] == status["displacement"]["state"] == "ok"
    assert status["estimate"]["can_state"] in ("ok", "late")
    counters = status["imu"]
    record_property("missed share", counters["missed"] / (counters["missed"] + counters["samples"]))

    estimates = [decoded(message) for message in frames]
    counters_seen = [int(estimate["counter"]) for estimate in estimates]
    assert counters_seen == [(counters_seen[0] + i) % 16 for i in range(len(frames))]
    assert all(message.data[7] == crc8_j1850(bytes(message.data[:7])) for message in frames)
    # The ram rests retracted for its first ten seconds.
    assert abs(estimates[-1]["displacement"]) < 4 * estimates[-1]["sigma"] < 40

    (path,) = (config.parent / "recordings").iterdir()
    assert replay(path).identical is True
    recording = Recording(path)
    health: list[Health] = []
    sent: list[bytes] = []
    for topic, record in recording.messages():
        if isinstance(record, Health):
            health.append(record)
        elif topic == topics.CAN_TX:
            assert isinstance(record, Frame)
            sent.append(record.data)
    assert (recording.complete, recording.lost) == (True, 0)
    assert recording.counts[topics.IMU_RAW] > 1000
    assert recording.counts[topics.OBSERVED] > 30
    assert recording.counts[topics.REFERENCE] > recording.counts[topics.OBSERVED]
    assert len(health) >= 3
    assert sent[: len(frames)] == [bytes(message.data) for message in frames]


def test_sim_is_refused_a_socket_in_use(config: Path) -> None:
    with started("sim", config) as first:
        deadline = time.monotonic() + PATIENCE_S
        while not (config.parent / "imu").exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        with started("sim", config) as second:
            _, said = second.communicate(timeout=PATIENCE_S)
        assert second.returncode == 1
        assert said.startswith("ramstroke: ")
        assert f"{config.parent}/imu is served by another program" in said
        assert said.count("\n") == 1
        os.kill(first.pid, signal.SIGTERM)
        assert first.wait(PATIENCE_S) == 0
