"""`make bench`: speed and accuracy figures side by side in one run. Nothing is asserted; machines differ."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from unittest.mock import patch

import numpy as np

from daemon import terminal
from daemon.offline.evaluation.runs import evaluate, records_of
from daemon.offline.evaluation.scenarios import SCENARIOS_OF_EVALUATION
from daemon.offline.evaluation.score import Case
from daemon.offline.evaluation.summary import summarise, summarise_clock
from daemon.offline.replaying.replay import replay
from daemon.recording.metadata import describe
from daemon.recording.reader import Recording
from daemon.recording.recover import recover
from daemon.recording.topics import IMU_RAW
from daemon.recording.writer import RecordingWriter
from daemon.simulation.demo import demo_settings, run_demo
from drivers.virtual.motion import RATE_HZ
from drivers.virtual.support import VirtualSupport
from estimation.pipeline import Pipeline, Start
from estimation.records import ImuSample
from estimation.tuning import compiled
from estimation.tuning.artificial import ARTIFICIAL, observed
from estimation.tuning.two_state_pass import exact
from estimation.tuning.two_state_tuning import tune

SEEDS = range(1, 11)
MODES = SCENARIOS_OF_EVALUATION["nominal"].modes


def _cpu_s(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def _filterpy_steps(count: int) -> None:
    """Predict and update of three states (position, velocity, acceleration) with the well-known library."""
    from filterpy.kalman import KalmanFilter

    dt = 1 / RATE_HZ
    kalman = KalmanFilter(dim_x=3, dim_z=1)
    kalman.F = np.array([[1, dt, dt * dt / 2], [0, 1, dt], [0, 0, 1]])
    kalman.H = np.array([[1.0, 0.0, 0.0]])
    kalman.Q, kalman.R = np.eye(3) * 1e-6, np.eye(1) * 1e-5
    for _ in range(count):
        kalman.predict()
        kalman.update(0.1)


def _vqf_updates(samples: Sequence[ImuSample]) -> None:
    """Orientation alone, compiled."""
    from vqf import VQF

    orientation = VQF(1 / RATE_HZ)
    for sample in samples:
        orientation.update(np.array(sample.gyro), np.array(sample.accel))


def _speed(folder: Path) -> None:
    made = terminal.table("Speed, CPU time", "what", "per inertial sample", "× real time")

    def row(what: str, cpu_s: float, samples: int) -> None:
        made.add_row(what, f"{cpu_s / samples * 1e6:.1f} µs", f"{samples / RATE_HZ / cpu_s:.0f}")

    support = VirtualSupport(1, cycles=1)
    records = list(records_of(support, support.observations()))
    inertial = [record for record in records if isinstance(record, ImuSample)]
    samples = len(inertial)
    Pipeline.prepare()
    pipeline = Pipeline(start=Start(0.0))
    row("estimator", _cpu_s(lambda: [pipeline.feed(record) for record in records]), samples)
    row("filterpy, 3-state predict and update", _cpu_s(lambda: _filterpy_steps(20_000)), 20_000)
    row("vqf, orientation update", _cpu_s(lambda: _vqf_updates(inertial)), samples)

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
    hours = samples / RATE_HZ / 3600
    terminal.OUT.print(f"recording: {recording.stat().st_size / hours / 1e6:.0f} MB an hour")


def _tuning() -> None:
    """Two thousand candidates of Q and R on paper A's signal, and whole tunings, on one cost function."""
    from filterpy.kalman import KalmanFilter

    motion, case = observed(ARTIFICIAL["AS-1"], 0), ARTIFICIAL["AS-1"]
    ratios = 10.0 ** np.linspace(-3, 3, 2000)

    def one_after_the_other() -> None:
        for ratio in ratios[:100]:
            exact(motion, np.array([ratio]))

    def with_filterpy() -> None:
        kalman = KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
        dt = case.dt_s
        kalman.F, kalman.B = np.array([[1, dt], [0, 1]]), np.array([[dt * dt / 2], [dt]])
        kalman.H, kalman.P, kalman.Q, kalman.R = (
            np.array([[1.0, 0]]),
            np.zeros((2, 2)),
            kalman.B @ kalman.B.T,
            np.eye(1),
        )
        for y in motion.y:
            kalman.predict(u=np.zeros((1, 1)))
            kalman.update(y)

    made = terminal.table(f"Evaluations of Q and R, {len(motion.y)} samples", "what", "CPU ms each")
    for what, work, count, is_compiled in (
        ("2,000 candidates at once, numpy", lambda: exact(motion, ratios), 2000, False),
        ("one after the other, plain floats", one_after_the_other, 100, False),
        ("2,000 candidates, compiled", lambda: exact(motion, ratios), 2000, True),
        ("filterpy", with_filterpy, 1, False),
    ):
        with patch.object(compiled, "wanted", return_value=is_compiled):
            if is_compiled:
                work()  # compiles
            made.add_row(what, f"{_cpu_s(work) / count * 1e3:.3f}")
    terminal.OUT.print(made)
    made = terminal.table("Whole tunings of AS-1 by the truth", "method", "CPU ms", "evaluations")
    tune([motion], "BqB", budget=30)  # what loads on use is loaded, and compiled
    for method in ("auto", "nelder_mead", "de", "cma", "ifoa_a"):
        begun = time.process_time()
        tuned = tune([motion], "BqB", method, "truth")
        made.add_row(method, f"{(time.process_time() - begun) * 1e3:.0f}", str(tuned.evaluations))
    terminal.OUT.print(made)


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
    _tuning()
    _accuracy()
