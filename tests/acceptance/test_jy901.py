"""The whole program on a JY901: `sim` and `run` as two programs over a pseudo-terminal, alone and beside."""

from __future__ import annotations

import json
import random
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from daemon.cli import main
from daemon.offline.replaying.replay import replay
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import Health
from drivers.jy901.reading import Reading
from tests.acceptance.test_two_processes import ended, started

PATIENCE_S = 60.0
SCRIPT = """\
[[fault]]
kind = "serial_garbage"
at_s = 5.0
for_s = 1.0
[[fault]]
kind = "serial_drops"
at_s = 7.0
for_s = 1.0
[[fault]]
kind = "serial_cut"
at_s = 9.0
for_s = 1.0
[[fault]]
kind = "adapter_gone"
at_s = 12.0
for_s = 1.0
[[fault]]
kind = "jy901_brown_out"
at_s = 16.0
for_s = 0.5
"""


def config(folder: Path, use: str) -> Path:
    path = folder / "trial.toml"
    path.write_text(
        f'[imu]\ntransport = "socket"\nsocket_path = "{folder}/imu"\n'
        f'[jy901]\nuse = "{use}"\nport = "{folder}/jy901"\n'
        '[can]\ninterface = "udp_multicast"\nchannel = "239.74.163.78"\n'
        f"port = {random.SystemRandom().randrange(20_000, 60_000)}\nlisten_only = false\n"
        f'[recording]\ndirectory = "{folder}/recordings"\nkeep_free_mb = 0\n'
        f'[service]\nsocket = "{folder}/live"\nstate_file = "{folder}/state.json"\n'
        "[simulation]\nseed = 4\n"
    )
    return path


def health_of(recording: Path) -> list[dict[str, Any]]:
    return [
        json.loads(record.json)
        for _, record in Recording(recording).messages((topics.HEALTH,))
        if isinstance(record, Health)
    ]


def readings_of(recording: Path) -> list[Reading]:
    return [one for _, one in Recording(recording).messages((topics.JY901,)) if isinstance(one, Reading)]


@pytest.mark.parametrize("use", ["instead", "beside"])
def test_garbage_half_packets_and_a_pulled_cable_are_survived(
    short_path: Path, use: str, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = config(short_path, use)
    script = short_path / "faults.toml"
    script.write_text(SCRIPT)
    with started("sim", chosen, "--faults", str(script), "--json") as sim, started("run", chosen) as run:
        time.sleep(20.0)
        assert main(["status", "--config", str(chosen), "--json"]) == 0
        status = json.loads(capsys.readouterr().out)
        said = ended(run, signal.SIGTERM)
        sim.send_signal(signal.SIGTERM)
        account = json.loads(sim.communicate(timeout=PATIENCE_S)[0])
    (recording,) = (short_path / "recordings").glob("*.mcap")
    part = "imu" if use == "instead" else "jy901"
    assert status[part]["state"] in ("ok", "ill"), said
    assert status[part]["firmware"] == 4711
    assert status[part]["errors"] == 0
    told = {health[part]["what"] for health in health_of(recording)}
    assert any("serial port" in what for what in told), told
    readings = readings_of(recording)
    last = health_of(recording)[-1][part]
    assert last["samples"] == len(readings)
    assert last["starts"] >= 3  # at the beginning, after the adapter, after the brown-out
    assert last["halves"] > 0
    assert account["jy901"]["added_by_script"] > 0
    assert account["jy901"]["lost_by_script"] > 0
    assert len(readings) < account["jy901"]["groups"]
    result = replay(recording)
    assert result.identical
    if use == "instead":
        assert result.samples == len(readings)
    else:
        assert result.samples > 5 * len(readings) / 2
        assert [one for one, _ in Recording(recording).messages((topics.IMU_IDENTITY,))] == [topics.IMU_IDENTITY]
