"""What is claimed of the stroke after a restart: by the sensor, by the saved state, or honestly nothing."""

from __future__ import annotations

import json
import logging
import os
import random
from collections.abc import Callable
from math import hypot, sqrt
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.recording import topics
from daemon.recording.topics import Recorded, RecordedDisplacement
from daemon.service.state_file import LARGEST_FILE_BYTES, SavedStroke, load, save
from daemon.settings import Settings
from daemon.stream import Stream
from estimation.pipeline import Start
from estimation.records import CanState, Displacement, Estimate, Event, ImuSample

NOW_S = 1_800_000_000.0
AT_300 = SavedStroke(wall_time_s=NOW_S - 3600, stroke_mm=500, displacement_mm=300, sigma_mm=2, at_rest=True)


def estimates_at_rest(
    start: Start, sensor_m: Callable[[int], float | None] = lambda _: None
) -> tuple[list[Estimate], list[str]]:
    """Eight seconds at rest, a displacement reading 15 times a second: provisional estimates and events."""
    estimates: list[Estimate] = []
    events: list[str] = []

    def sink(topic: str, record: Recorded) -> None:
        if topic == topics.PROVISIONAL:
            assert isinstance(record, Estimate)
            estimates.append(record)
        elif isinstance(record, Event):
            events.append(record.what)

    chance = random.Random(7)
    stream = Stream(Settings.model_validate({"can": {"interface": "socketcan"}}), sink, start)
    for number in range(8 * 819):
        t_ns = round(number / 819.2 * 1e9)
        x, y, z = (chance.gauss(0.0, 0.02) for _ in range(3))
        gyro = tuple(chance.gauss(0.0, 0.004) for _ in range(3))
        stream.take(topics.IMU_SAMPLE, ImuSample(t_ns, (gyro[0], gyro[1], gyro[2]), (x, y, z + 9.8)))
        value_m = sensor_m(number) if number % 55 == 0 else None
        if value_m is not None:
            reading = Displacement(t_ns, value_m + round(chance.gauss(0.0, 3.0)) / 1e3)
            stream.take(topics.OBSERVED, RecordedDisplacement(reading, decoded=False))
    return estimates, events


def test_with_the_sensor_the_stroke_is_what_the_sensor_says_however_wrong_the_saved_one() -> None:
    elsewhere = AT_300.model_copy(update={"displacement_mm": 120.0}).start(NOW_S)
    estimates, events = estimates_at_rest(elsewhere, lambda _: 0.300)
    last = estimates[-1]
    assert last.can_state is CanState.OK
    assert abs(last.displacement_m - 0.300) < 3 * last.sigma_m
    # Noise of 3 mm, 120 readings; what remains are offset, scale and bow of the sensor.
    known = EXPECTED_SIGMA_WITH_SENSOR_M
    assert 0.5 * known < last.sigma_m < 2 * known
    assert events == []
    # Also before the first reading nothing wrong was claimed.
    assert all(abs(e.displacement_m - 0.300) < 4 * e.sigma_m for e in estimates)


# Settings' defaults: offset 1.5 mm, scale 1.8 % of 300 mm, bow 1.2 mm at half stroke; no noise left.
EXPECTED_SIGMA_WITH_SENSOR_M = hypot(0.0015, 0.018 * 0.300, 0.0012)


def test_without_the_sensor_the_saved_stroke_is_believed_with_doubt_added() -> None:
    estimates, events = estimates_at_rest(AT_300.start(NOW_S))
    first, last = estimates[0], estimates[-1]
    # Until the sensor has had its chance to speak, nothing is claimed.
    assert (first.displacement_m, first.sigma_m) == pytest.approx((0.250, 0.5 / sqrt(12)), rel=1e-3)
    assert last.displacement_m == pytest.approx(0.300, abs=1e-4)
    # 2 mm saved, 5 mm for a ram that nobody watched, 10 mm for the hour.
    assert last.sigma_m == pytest.approx(hypot(0.002, 0.005, 0.010), rel=0.01)
    assert last.can_state is CanState.ABSENT
    assert events == ["no displacement reading: the saved stroke is believed"]


def test_without_sensor_and_saved_state_the_stroke_is_undetermined() -> None:
    estimates, events = estimates_at_rest(Start())
    assert [e.displacement_m for e in estimates] == pytest.approx([0.250] * len(estimates), abs=1e-4)
    assert [e.sigma_m for e in estimates] == pytest.approx([0.5 / sqrt(12)] * len(estimates), rel=1e-3)
    assert events == []


def test_a_sensor_that_speaks_late_corrects_the_saved_stroke() -> None:
    estimates, events = estimates_at_rest(
        AT_300.model_copy(update={"displacement_mm": 285.0}).start(NOW_S),
        lambda number: 0.300 if number > 4 * 819 else None,
    )
    believed = estimates[3 * 102]
    assert believed.displacement_m == pytest.approx(0.285, abs=1e-4)
    assert abs(estimates[-1].displacement_m - 0.300) < abs(believed.displacement_m - 0.300) / 2
    assert estimates[-1].sigma_m < believed.sigma_m
    assert events == ["no displacement reading: the saved stroke is believed"]


def test_what_was_saved_is_loaded_with_the_doubt_of_the_time_between(tmp_path: Path) -> None:
    path = tmp_path / "made" / "state.json"
    save(path, AT_300)
    start = load(path, 500, NOW_S)
    assert start.displacement_m == pytest.approx(0.300)
    assert start.sigma_m == pytest.approx(sqrt(0.002**2 + 0.005**2 + 0.010**2))
    assert start.only_without_sensor
    later = load(path, 500, NOW_S + 5 * 3600)
    assert later.sigma_m == pytest.approx(sqrt(0.002**2 + 0.005**2 + 0.060**2))


def saved(**changes: object) -> str:
    return json.dumps(AT_300.model_dump() | changes)


USELESS = {
    "empty": ("", "is damaged or of another version"),
    "cut": (saved()[:40], "is damaged or of another version"),
    "no JSON": ("stroke=300", "is damaged or of another version"),
    "other JSON": ("[]", "is damaged or of another version"),
    "deeply nested": ("[" * 50_000, "is damaged or of another version"),
    "missing key": ('{"format": 1}', "is damaged or of another version"),
    "unknown key": (saved(colour="red"), "is damaged or of another version"),
    "text for a number": (saved(displacement_mm="far"), "is damaged or of another version"),
    "not a number": (saved(displacement_mm=float("nan")), "is damaged or of another version"),
    "infinite": (saved(sigma_mm=float("inf")), "is damaged or of another version"),
    "negative sigma": (saved(sigma_mm=-1), "is damaged or of another version"),
    "larger than any": (saved()[:-1] + " " * LARGEST_FILE_BYTES + "}", "is damaged or of another version"),
    "other format": (saved(format=2), "was saved for another support or version"),
    "other support": (saved(stroke_mm=600), "was saved for another support or version"),
    "stroke beyond the stop": (saved(displacement_mm=1e300), "holds an impossible stroke"),
    "stroke before the stop": (saved(displacement_mm=-200), "holds an impossible stroke"),
    "in a move": (saved(at_rest=False), "was saved during a move"),
    "years ago": (saved(wall_time_s=1.0), "is too old or was too uncertain"),
    "huge sigma": (saved(sigma_mm=1e300), "is too old or was too uncertain"),
    "from the future": (saved(wall_time_s=NOW_S + 3600), "the computer's clock is not to be trusted"),
}


@pytest.mark.parametrize("what", USELESS)
def test_a_useless_file_leaves_the_stroke_undetermined_and_the_log_says_why(
    what: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text, reason = USELESS[what]
    path = tmp_path / "state.json"
    path.write_text(text)
    with caplog.at_level(logging.WARNING):
        assert load(path, 500, NOW_S) == Start()
    (line,) = caplog.messages
    assert reason in line
    assert line.endswith(": the stroke is undetermined")


def test_a_first_start_says_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert load(tmp_path / "state.json", 500) == Start()
    assert caplog.messages == []


def test_what_cannot_be_read_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert load(tmp_path, 500) == Start()
    assert caplog.messages == [f"{tmp_path} cannot be read (Is a directory): the stroke is undetermined"]


@settings(derandomize=True, deadline=None, max_examples=200)
@given(st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_no_bytes_whatever_stop_the_start(data: bytes) -> None:
    path = Path(f"/tmp/ramstroke-state-{os.getpid()}")
    try:
        path.write_bytes(data)
        assert load(path, 500, NOW_S) == Start()
    finally:
        path.unlink()


@settings(derandomize=True, deadline=None)
@given(
    sigma_mm=st.floats(0, 1e308),
    wall_time_s=st.floats(0, 1e308),
    displacement_mm=st.floats(-1e308, 1e308),
)
def test_no_numbers_claim_more_than_was_known(sigma_mm: float, wall_time_s: float, displacement_mm: float) -> None:
    start = SavedStroke(
        wall_time_s=wall_time_s,
        stroke_mm=500,
        displacement_mm=displacement_mm,
        sigma_mm=sigma_mm,
        at_rest=True,
    ).start(NOW_S)
    if start != Start():
        assert start.sigma_m >= max(sigma_mm / 1e3, 0.005)
        assert start.sigma_m < 0.5 / sqrt(12)


class Crash(Exception):
    """The power goes."""


@pytest.mark.parametrize(("owner", "step"), [(os, "fsync"), (Path, "replace")])
def test_a_crash_while_saving_leaves_the_old_file(
    owner: object, step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "state.json"
    save(path, AT_300)
    before = path.read_bytes()

    def crash(*_: object) -> None:
        raise Crash

    with monkeypatch.context() as patch:
        patch.setattr(owner, step, crash)
        with pytest.raises(Crash):
            save(path, AT_300.model_copy(update={"displacement_mm": 111.0}))
    assert path.read_bytes() == before
    save(path, AT_300.model_copy(update={"displacement_mm": 222.0}))
    assert load(path, 500, NOW_S).displacement_m == pytest.approx(0.222)
    assert [p.name for p in tmp_path.iterdir()] == ["state.json"]


def test_the_data_are_on_the_disk_before_the_name_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[str] = []
    real_replace = Path.replace

    def replace(path: Path, target: Path) -> Path:
        steps.append(f"rename to {target.name}")
        return real_replace(path, target)

    monkeypatch.setattr(os, "fsync", lambda _: steps.append("fsync"))
    monkeypatch.setattr(Path, "replace", replace)
    save(tmp_path / "state.json", AT_300)
    assert steps == ["fsync", "rename to state.json"]
