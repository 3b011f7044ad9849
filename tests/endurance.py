"""`ramstroke sim` and `ramstroke run` in real time with a long fault script: is every sample accounted for?

    python -m tests.endurance --minutes 30

Prints the accounts of both sides, what is left unexplained, and memory over time. Nothing is asserted.
"""

from __future__ import annotations

import argparse
import json
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from daemon.offline.replaying.replay import replay
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import Health
from drivers.adis16448.burst import Burst, Fault
from drivers.can.frame import Frame
from estimation.records import Move

SCRIPT = Path(__file__).parent.parent / "config" / "faults" / "long.toml"
LOOK_S = 15.0


def _config(folder: Path) -> Path:
    path = folder / "endurance.toml"
    path.write_text(
        f'[imu]\ntransport = "socket"\nsocket_path = "{folder}/imu"\n'
        '[can]\ninterface = "udp_multicast"\nchannel = "239.74.163.91"\nlisten_only = false\n'
        f"port = {random.SystemRandom().randrange(20_000, 60_000)}\n"
        '[can.reference]\nmessage = "LaboratorySensor"\nsignal = "reference_stroke"\n'
        "[can.publish]\nenabled = true\n"
        f'[recording]\ndirectory = "{folder}/recordings"\nkeep_free_mb = 0\nrotate_minutes = 7\n'
        f'[service]\nsocket = "{folder}/live"\nstate_file = "{folder}/state.json"\n'
        "[simulation]\nseed = 3\n"
    )
    return path


def _start(command: str, config: Path, *more: str) -> subprocess.Popen[str]:
    arguments = [sys.executable, "-m", "daemon.cli", command, "--config", str(config), *more]
    with (config.parent / f"{command}.log").open("w") as log:
        return subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=log, text=True)


def _rss_mb(process: subprocess.Popen[str]) -> float:
    for line in Path(f"/proc/{process.pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    return 0.0


def _recordings(folder: Path) -> dict[str, Any]:
    """What all files hold together, and whether each replays bit for bit."""
    bursts: dict[str, int] = {}
    frames = backward = moves = 0
    identical, last_ns, health = [], 0, {}
    for path in sorted((folder / "recordings").glob("*.mcap")):
        recording = Recording(path)
        for topic, record in recording.messages():
            if isinstance(record, Burst):
                name = Fault(record.fault).name.lower()
                bursts[name] = bursts.get(name, 0) + 1
                backward += record.t_ns < last_ns
                last_ns = record.t_ns
            elif isinstance(record, Frame):
                frames += topic == topics.CAN_RX
            elif isinstance(record, Move):
                moves += 1
            elif isinstance(record, Health):
                health = json.loads(record.json)
        identical.append(replay(path).identical)
    return {
        "files": len(identical),
        "identical": all(identical),
        "bursts": bursts,
        "frames": frames,
        "moves": moves,
        "backward": backward,
        "health": health,
    }


def main() -> None:
    """Run both programs, then compare their accounts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--faults", type=Path, default=SCRIPT)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="rs-", dir="/tmp") as name:
        folder = Path(name)
        config = _config(folder)
        run, sim = _start("run", config), _start("sim", config, "--faults", str(arguments.faults), "--json")
        memory: list[tuple[float, float]] = []
        began_s = time.monotonic()
        while (left_s := began_s + arguments.minutes * 60 - time.monotonic()) > 0:
            time.sleep(min(LOOK_S, left_s))
            memory.append((_rss_mb(run), _rss_mb(sim)))
        run.send_signal(signal.SIGTERM)
        run.communicate(timeout=60)
        used = resource.getrusage(resource.RUSAGE_CHILDREN)  # by `run`: `sim` has not ended yet
        sim.send_signal(signal.SIGTERM)
        account = json.loads(sim.communicate(timeout=60)[0])
        found = _recordings(folder)
        log = (folder / "run.log").read_text()

    imu, can = found["health"]["imu"], found["health"]["can"]
    heard = imu["edge_reads"] + imu["missed"] + imu["missed_starting"] + imu["unheeded"]
    report = {
        "exit codes": (run.returncode, sim.returncode),
        "updates of the part": account["part"]["updates"],
        "edges lost, added by the script": (
            account["part"]["edges_lost_by_script"],
            account["part"]["edges_added_by_script"],
        ),
        "edges told to run": account["socket"]["edges"],
        "edges read, missed, missed while starting, unheeded": (
            imu["edge_reads"],
            imu["missed"],
            imu["missed_starting"],
            imu["unheeded"],
        ),
        "edges unexplained at the last health record": account["socket"]["edges"] - heard,
        "samples, paced": (imu["samples"], imu["paced_reads"]),
        "faults": imu["faults"],
        "samples without a verdict": imu["samples"] - found["bursts"].get("none", 0) - sum(imu["faults"].values()),
        "recorded": found["bursts"],
        "frames recorded, received": (found["frames"], can["received"]),
        "can": {k: v for k, v in can.items() if isinstance(v, int) and v},
        "frames sent": account["can"],
        "moves": found["moves"],
        "files, all identical, time back": (found["files"], found["identical"], found["backward"]),
        "recorder": {k: v for k, v in found["health"]["recorder"].items() if isinstance(v, int)},
        "memory of run, sim MB (every tenth)": [(round(a, 1), round(b, 1)) for a, b in memory[::10]],
        "memory of run after a third, at the end": (memory[len(memory) // 3][0], memory[-1][0]),
        "cpu of run s": used.ru_utime + used.ru_stime,
        "log lines": log.count("\n"),
        "tracebacks": log.count("Traceback"),
        "faults played": len(account["faults"]),
    }
    for what, value in report.items():
        print(f"{what}: {value}")


if __name__ == "__main__":
    main()
