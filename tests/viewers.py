"""Five browsers on `ramstroke view` against nobody, beside a daemon in real time: do they disturb it?

    python -m tests.viewers --minutes 5

Stretches with and without take turns, so that both see the same computer; without, the view process does not run
either. Latency of a published frame: from the last inertial sample of its step (the frame's time in the recording) to
its arrival at an independent reader on the bus. Prints both sides and their ratios. Nothing is asserted.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import can

from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import Health
from drivers.can.frame import Frame

GROUP = "239.74.163.92"
ESTIMATE_ID = 0x6F0
BROWSERS = 5
STRETCH_S = 30.0
SETTLE_S = 6.0  # at the begin of each stretch: programs start and end

Stretch = tuple[bool, float, float]  # with browsers; from, to (monotonic)


def _config(folder: Path, port: int) -> Path:
    path = folder / "viewers.toml"
    path.write_text(
        f'[imu]\ntransport = "socket"\nsocket_path = "{folder}/imu"\n'
        f'[can]\ninterface = "udp_multicast"\nchannel = "{GROUP}"\nport = {port}\nlisten_only = false\n'
        "[can.publish]\nenabled = true\n"
        f'[recording]\ndirectory = "{folder}/recordings"\nkeep_free_mb = 0\n'
        f'[service]\nsocket = "{folder}/live"\nstate_file = "{folder}/state.json"\n'
    )
    return path


def _start(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-m", *arguments], stdout=subprocess.DEVNULL, text=True)


def _end(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGTERM)
    process.wait(30)


async def _browse(port: int) -> None:
    """Five browsers that read everything, until they are ended."""
    import aiohttp

    async def one(session: aiohttp.ClientSession) -> None:
        while True:
            try:
                async with session.ws_connect(f"http://127.0.0.1:{port}/live") as channel:
                    async for message in channel:
                        json.loads(message.data)
            except aiohttp.ClientError:
                await asyncio.sleep(0.2)

    async with aiohttp.ClientSession() as session:
        await asyncio.gather(*(one(session) for _ in range(BROWSERS)))


def _listen(port: int, arrivals: list[tuple[int, bytes]], stopping: threading.Event) -> None:
    with can.Bus(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0) as bus:
        while not stopping.is_set():
            message = bus.recv(0.2)
            if message is not None and message.arbitration_id == ESTIMATE_ID:
                arrivals.append((time.monotonic_ns(), bytes(message.data)))


def _take_turns(config: Path, minutes: float) -> list[Stretch]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    stretches: list[Stretch] = []
    for number in range(2 * round(minutes * 60 / STRETCH_S)):
        programs = []
        if number % 2:
            programs = [
                _start("daemon.cli", "view", "--config", str(config), "--port", str(port)),
                _start("tests.viewers", "--browse", str(port)),
            ]
        time.sleep(SETTLE_S)
        begin_s = time.monotonic()
        time.sleep(STRETCH_S)
        stretches.append((bool(programs), begin_s, time.monotonic()))
        for program in programs:
            _end(program)
        print(f"stretch {number + 1}: {'five browsers' if programs else 'nobody'}", file=sys.stderr, flush=True)
    return stretches


def _percentile(values: list[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(round(share * len(ordered)), len(ordered) - 1)]


def _latencies(recorded: list[Frame], arrivals: list[tuple[int, bytes]]) -> list[tuple[float, float]]:
    """(time, latency in ms) of each frame that was recorded and arrived: the same bytes, in order, within a second."""
    found = []
    rest = iter(arrivals)
    arrival = next(rest, None)
    for frame in recorded:
        while arrival is not None and arrival[0] < frame.t_ns:
            arrival = next(rest, None)
        if arrival is not None and arrival[1] == frame.data and arrival[0] - frame.t_ns < 1_000_000_000:
            found.append((arrival[0] * 1e-9, (arrival[0] - frame.t_ns) * 1e-6))
            arrival = next(rest, None)
    return found


def _counted(health: list[dict[str, Any]], stretch: Stretch) -> dict[str, int]:
    inside = [row for row in health if stretch[1] <= row["t_s"] <= stretch[2]]
    if len(inside) < 2:
        return {}
    first, last = inside[0], inside[-1]
    counted = {name: last["imu"].get(name, 0) - first["imu"].get(name, 0) for name in ("samples", "missed")}
    torn = [row["imu"].get("faults", {}).get("torn", 0) for row in (first, last)]
    lines = [row["live"]["dropped"] for row in (first, last)]
    return counted | {"torn": torn[1] - torn[0], "lines_dropped": lines[1] - lines[0]}


def _report(folder: Path, arrivals: list[tuple[int, bytes]], stretches: list[Stretch]) -> dict[str, Any]:
    recorded: list[Frame] = []
    health: list[dict[str, Any]] = []
    for path in sorted((folder / "recordings").glob("*.mcap")):
        for topic, record in Recording(path).messages():
            if isinstance(record, Health):
                health.append(json.loads(record.json))
            elif topic == topics.CAN_TX and isinstance(record, Frame):
                recorded.append(record)
    latencies = _latencies(recorded, arrivals)
    sides: dict[str, dict[str, float]] = {}
    for name, with_browsers in (("nobody", False), ("five_browsers", True)):
        mine = [stretch for stretch in stretches if stretch[0] is with_browsers]
        values = [ms for t_s, ms in latencies if any(begin <= t_s <= end for _, begin, end in mine)]
        late = [row["loop"]["late_ms"] for row in health if any(b <= row["t_s"] <= e for _, b, e in mine)]
        side: dict[str, float] = {"frames": len(values)}
        side |= {f"p{share}_ms": round(_percentile(values, share / 100), 3) for share in (50, 95, 99)}
        side["loop_late_p50_ms"] = round(_percentile(late, 0.5), 3)
        for stretch in mine:
            for key, count in _counted(health, stretch).items():
                side[key] = side.get(key, 0) + count
        sides[name] = side
    nobody, browsers = sides["nobody"], sides["five_browsers"]
    ratios = {key: round(browsers[key] / nobody[key], 3) for key in nobody if nobody[key]}
    return sides | {"ratios": ratios}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0, help="of each kind")
    parser.add_argument("--browse", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.browse:
        os.nice(19)  # on a real support browsers run on other computers
        asyncio.run(_browse(arguments.browse))
        return
    arrivals: list[tuple[int, bytes]] = []
    stopping = threading.Event()
    with tempfile.TemporaryDirectory(prefix="rs-") as name:
        folder = Path(name)
        port = random.SystemRandom().randrange(20_000, 60_000)
        config = _config(folder, port)
        listener = threading.Thread(target=_listen, args=(port, arrivals, stopping))
        listener.start()
        sim = _start("daemon.cli", "sim", "--config", str(config))
        daemon = _start("daemon.cli", "run", "--config", str(config))
        try:
            time.sleep(SETTLE_S)
            stretches = _take_turns(config, arguments.minutes)
        finally:
            _end(daemon)
            _end(sim)
            stopping.set()
            listener.join()
        print(json.dumps(_report(folder, arrivals, stretches), indent=2))


if __name__ == "__main__":
    main()
