"""A real recording through the whole program. It is no cylinder: displacement accuracy is not judged."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from daemon.cli import main
from drivers.adis16448.burst import Burst, BurstDecoder, Fault
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.machine import InertialSensor
from drivers.adis16448.registers import ACCEL_LSB, BASE_RATE_HZ, GYRO_LSB_DPS
from drivers.clock import VirtualClock
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.inertial_input import RecordedInput
from estimation.records import TimeKind
from tests import broad

BROAD_RATE_HZ = 2000 / 7  # of the recording


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("broad")
    broad.load().write_table(folder / "broad.csv")
    assert main(["import", str(folder / "broad.csv"), "-o", str(folder / "broad.mcap")]) == 0
    return folder / "broad.mcap"


@pytest.fixture(scope="module")
def steps(imported: Path) -> list[dict[str, str]]:
    table = imported.with_suffix(".steps.csv")
    assert main(["replay", str(imported), "--csv", str(table)]) == 0
    with table.open() as stream:
        return list(csv.DictReader(stream))


def test_labelled_rest_is_zupt_and_motion_is_not(steps: list[dict[str, str]]) -> None:
    recording = broad.load()
    moving = dict(zip((round(float(t) * 1e6) for t in recording.t_s), recording.moving.tolist(), strict=True))
    zupt = {True: [], False: []}  # type: dict[bool, list[bool]]
    for step in steps:
        zupt[moving[round(float(step["t_s"]) * 1e6)]].append(step["segment"] == "ZUPT")
    assert steps[0]["segment"] == "ZUPT"
    assert np.mean(zupt[False]) >= 0.95
    assert np.mean(zupt[True]) <= 0.10


def test_no_small_sigma_is_claimed_that_the_reference_refutes(steps: list[dict[str, str]]) -> None:
    recording = broad.load()
    times = np.array([float(t) for t in recording.t_s])
    reference = recording.reference_mm(axis=1)
    known = ~np.isnan(reference)
    for step in steps:
        truth = np.interp(float(step["t_s"]), times[known], reference[known])
        assert abs(float(step["displacement_mm"]) - truth) <= 3.0 * float(step["sigma_mm"]) + 5.0


def test_review_tells_of_the_unexplained_motion(imported: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["review", str(imported), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert any("neither a push nor a retract" in event["what"] for event in told["events"])
    assert told["moves"] == []
    assert told["reference"]["readings"] > 1000


def test_recording_through_the_virtual_sensor_gives_the_same_samples_to_half_an_lsb() -> None:
    """No averaging, paced by the recording, which begins when the part is set up: what was put in is read."""
    recording = broad.load()
    clock = VirtualClock()
    settings = ImuSettings(transport="virtual", gyro_range_dps=1000, filter_taps_exponent=0)
    # A part whose line brings a third of its edges would be read in paces: played at the part's own rate.
    t_ns = np.array([round(float(t) * 1e9 * BROAD_RATE_HZ / BASE_RATE_HZ) for t in recording.t_s])
    gyro, accel = recording.motion[:, :3], recording.motion[:, 3:]
    part = VirtualAdis16448(RecordedInput(t_ns, gyro, accel, start_ns=160_000_000), clock)
    sensor = InertialSensor(settings, clock, lambda: part, part.data_ready)
    bursts: list[Burst] = []
    while not part.exhausted:
        bursts += [item for item in sensor.read_block() if isinstance(item, Burst)]

    # A sample that equals the one before may be told as repeated; it still was read.
    # After the last sample there is no edge any more, and its registers are read in paces for a moment.
    announced = [burst for burst in bursts if burst.time_kind is TimeKind.EDGE]
    good = [burst for burst in announced if burst.fault in (Fault.NONE, Fault.REPEATED)]
    assert len(good) == len(t_ns)
    decoder = BurstDecoder(settings.gyro_range_dps)
    samples = [decoder.sample(burst) for burst in good]
    assert np.array_equal(np.array([s.t_ns for s in samples]) - samples[0].t_ns, t_ns - t_ns[0])
    half_gyro = 0.5 * np.radians(GYRO_LSB_DPS[1000]) * (1 + 1e-9)
    assert np.abs(np.array([s.gyro for s in samples]) - gyro).max() <= half_gyro
    assert np.abs(np.array([s.accel for s in samples]) - accel).max() <= 0.5 * ACCEL_LSB * (1 + 1e-9)
