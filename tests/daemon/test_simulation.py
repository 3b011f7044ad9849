"""`ramstroke sim --faults`: a program of its own that goes wrong as told and accounts for everything it did."""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import can
import pytest

from drivers.spi import SpiError
from drivers.virtual.spi_socket import SocketDataReady, SocketTransport

PATIENCE_S = 60.0
GROUP = "239.74.163.79"


@pytest.fixture
def config(short_path: Path) -> Path:
    path = short_path / "trial.toml"
    path.write_text(
        f'[imu]\ntransport = "socket"\nsocket_path = "{short_path}/imu"\n'
        f'[can]\ninterface = "udp_multicast"\nchannel = "{GROUP}"\nport = {port()}\n'
    )
    return path


def port() -> int:
    return random.SystemRandom().randrange(20_000, 60_000)


def connected(path: Path) -> SocketTransport:
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            return SocketTransport(str(path))
        except SpiError:
            assert time.monotonic() < deadline
            time.sleep(0.02)


def test_a_simulation_accounts_for_samples_edges_frames_and_faults(config: Path, short_path: Path) -> None:
    faults = short_path / "faults.toml"
    faults.write_text(
        '[[fault]]\nkind = "data_ready_lost"\nat_s = 0\nfor_s = 1000\nshare = 0.5\n'
        '[[fault]]\nkind = "spi_error"\nat_s = 0\nfor_s = 1000\n'
        '[[fault]]\nkind = "error_frames"\nat_s = 0\nfor_s = 1000\nrate_hz = 100\n'
        '[[fault]]\nkind = "can_silence"\nat_s = 0\nfor_s = 1000\n'
        '[[fault]]\nkind = "jump"\nat_s = 900\nfor_s = 1\noffset_mm = 5\n'
    )
    group = {line.split(" = ")[0]: line.split(" = ")[1] for line in config.read_text().splitlines() if " = " in line}
    command = [sys.executable, "-m", "daemon.cli", "sim", "--config", str(config), "--faults", str(faults), "--json"]
    with can.Bus(interface="udp_multicast", channel=GROUP, port=int(group["port"]), hop_limit=0) as bus:
        sim = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            transport = connected(short_path / "imu")
            line = SocketDataReady(str(short_path / "imu"))
            for _ in range(5):
                with pytest.raises(SpiError, match="as its fault script says"):
                    transport.transfer(b"\x56\x00", 1_000_000)
            heard = 0
            while heard < 200:
                edge = line.wait(PATIENCE_S)
                assert edge is not None
                heard += 1 + edge.missed
            messages: list[can.Message] = []
            while sum(message.is_error_frame for message in messages) < 20:
                message = bus.recv(PATIENCE_S)
                assert message is not None
                messages.append(message)
            sim.send_signal(signal.SIGTERM)
            out, said = sim.communicate(timeout=PATIENCE_S)
        finally:
            sim.kill()
            sim.wait()
    assert sim.returncode == 0, said
    account: dict[str, Any] = json.loads(out)
    part, served = account["part"], account["socket"]
    assert (served["frames"], served["failed_frames"]) == (5, 5)
    assert heard <= served["edges"] <= part["edges"]
    assert part["updates"] == part["edges"] + part["edges_lost_by_script"]
    assert part["edges_lost_by_script"] == pytest.approx(part["updates"] / 2, rel=0.4)
    assert part["updates"] > 200
    kinds = account["can"]["sent_by_kind"]
    assert kinds.keys() == {"error frame", "0x311"}
    assert sum(kinds.values()) == account["can"]["sent"]
    assert kinds["error frame"] >= 20
    assert account["can"]["failed"] == 0
    assert [fault["kind"] for fault in account["faults"]] == [
        "data_ready_lost",
        "spi_error",
        "error_frames",
        "can_silence",
    ]
    assert not [message for message in messages if message.arbitration_id == 0x310 and not message.is_error_frame]
    (line_of_account,) = [text for text in said.splitlines() if "virtual support ends: " in text]
    assert f" s; {part['updates']} samples; " in line_of_account
    assert "5 SPI frames, 5 of them failed by script" in line_of_account
    assert "4 faults played" in line_of_account
