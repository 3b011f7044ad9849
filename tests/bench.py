"""`make bench`: speed and accuracy figures side by side in one run. Nothing is asserted; machines differ."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from daemon import terminal
from daemon.offline.evaluation import MODES, evaluate, records_of
from daemon.offline.evaluation_score import Case
from daemon.offline.evaluation_summary import summarise, summarise_clock
from daemon.offline.replay import replay
from daemon.recording.metadata import describe
from daemon.recording.reader import Recording
from daemon.recording.recover import recover
from daemon.recording.topics import IMU_RAW
from daemon.recording.writer import RecordingWriter
from daemon.simulation.demo import demo_settings, run_demo
from drivers.virtual.support import VirtualSupport
from estimation.pipeline import Pipeline, Start

SEEDS = range(1, 11)


def _cpu_s(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def _textbook_kalman(samples: int) -> None:
    """Three states, predict and update, as numpy matrices: the yardstick."""
    dt = 1 / 819.2
    f = np.array([[1, dt, dt * dt / 2], [0, 1, dt], [0, 0, 1]])
    h = np.array([[1.0, 0.0, 0.0]])
    q, r = np.eye(3) * 1e-6, np.eye(1) * 1e-5
    x, p = np.zeros((3, 1)), np.eye(3)
    for _ in range(samples):
        x, p = f @ x, f @ p @ f.T + q
        gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
        x, p = x + gain @ (0.1 - h @ x), (np.eye(3) - gain @ h) @ p


def _speed(folder: Path) -> None:
    made = terminal.table("Speed, CPU time", "what", "per inertial sample", "× real time")

    def row(what: str, cpu_s: float, samples: int) -> None:
        made.add_row(what, f"{cpu_s / samples * 1e6:.1f} µs", f"{samples / 819.2 / cpu_s:.0f}")

    support = VirtualSupport(1, cycles=1)
    records = list(records_of(support, support.observations()))
    samples = sum(1 for record in records if hasattr(record, "gyro"))
    Pipeline.prepare()
    pipeline = Pipeline(start=Start(0.0))
    row("estimator", _cpu_s(lambda: [pipeline.feed(record) for record in records]), samples)
    row("3-state Kalman step, numpy matrices", _cpu_s(lambda: _textbook_kalman(20_000)), 20_000)

    recording = folder / "demo.mcap"
    row(
        "demo: twin, driver, bus, estimator, recorder",
        _cpu_s(lambda: run_demo(demo_settings(1), recording, lambda _: None)),
        samples,
    )
    row("replay of it", _cpu_s(lambda: replay(recording)), samples)
    row("reading it", _cpu_s(lambda: list(Recording(recording).messages())), samples)
    row("recover", _cpu_s(lambda: recover(recording, folder / "again.mcap")), samples)
    bursts = [record for _, record in Recording(recording).messages((IMU_RAW,))]

    def write() -> None:
        with RecordingWriter(folder / "bursts.mcap", describe("recording", "{}")) as writer:
            for burst in bursts:
                writer.write(IMU_RAW, burst)

    row("writing the bursts", _cpu_s(write), len(bursts))
    terminal.OUT.print(made)
    hours = samples / 819.2 / 3600
    terminal.OUT.print(f"recording: {recording.stat().st_size / hours / 1e6:.0f} MB an hour")


def _accuracy() -> None:
    results = evaluate([Case("nominal", seed, mode) for mode in MODES for seed in SEEDS], jobs=2)
    made = terminal.table(f"Accuracy, first cycle, {len(SEEDS)} seeds [mm]", "what", "median", "p95", "worst", "failed")
    rows = {f"{mode} push": summarise([r for r in results if r.case.mode == mode], 0) for mode in MODES}
    rows["clock push"] = summarise_clock([r for r in results if r.case.mode == MODES[0]], 0)
    for name, row in rows.items():
        made.add_row(name, *(f"{row[key]:.1f}" for key in ("median_mm", "p95_mm", "worst_mm")), str(row["failures"]))
    terminal.OUT.print(made)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        _speed(Path(name))
    _accuracy()
