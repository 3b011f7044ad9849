"""What is claimed after a restart: of the stroke by the sensor, by the saved state, or honestly nothing; and what was
learned, all of it or nothing."""

from __future__ import annotations

import json
import logging
import math
import os
import random
from collections.abc import Callable
from math import hypot, sqrt
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.machine import machine_of
from daemon.recording import topics
from daemon.recording.topics import Recorded, RecordedDisplacement
from daemon.service.state_file import LARGEST_FILE_BYTES, SavedState, load, read, save
from daemon.settings import Settings
from daemon.stream import Stream
from estimation.pipeline import Pipeline, Start
from estimation.records import CanState, Displacement, Estimate, Event, ImuSample
from tests.estimation.learned_kit import MEAN, learned_of

NOW_S = 1_800_000_000.0
SETTINGS = Settings()
AT_300 = SavedState(wall_time_s=NOW_S - 3600, stroke_mm=500, displacement_mm=300, sigma_mm=2, at_rest=True)


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
    elsewhere = AT_300.model_copy(update={"displacement_mm": 120.0}).start(SETTINGS, NOW_S)
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
    estimates, events = estimates_at_rest(AT_300.start(SETTINGS, NOW_S))
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
        AT_300.model_copy(update={"displacement_mm": 285.0}).start(SETTINGS, NOW_S),
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
    start = load(path, SETTINGS, NOW_S)
    assert start.displacement_m == pytest.approx(0.300)
    assert start.sigma_m == pytest.approx(sqrt(0.002**2 + 0.005**2 + 0.010**2))
    assert start.only_without_sensor
    later = load(path, SETTINGS, NOW_S + 5 * 3600)
    assert later.sigma_m == pytest.approx(sqrt(0.002**2 + 0.005**2 + 0.060**2))


CALIBRATED = AT_300.model_copy(update={"learned": learned_of(machine_of(SETTINGS))})


def saved(**changes: object) -> str:
    return json.dumps(AT_300.model_dump() | changes)


def saved_with(**changes: Any) -> str:
    """What was learned, with other things in it."""
    tree = CALIBRATED.model_dump()
    return json.dumps(tree | {"learned": tree["learned"] | changes})


def of_machine(**changes: Any) -> str:
    return saved_with(machine=machine_of(SETTINGS).model_dump() | changes)


NOTHING = ": the stroke is undetermined and nothing is learned yet"


DAMAGED = "is damaged or of another version"
USELESS = {
    "empty": ("", DAMAGED),
    "cut": (saved()[:40], DAMAGED),
    "no JSON": ("stroke=300", DAMAGED),
    "other JSON": ("[]", DAMAGED),
    "deeply nested": ("[" * 50_000, DAMAGED),
    "missing key": ('{"format": 1}', DAMAGED),
    "unknown key": (saved(colour="red"), DAMAGED),
    "text": (saved(displacement_mm="far"), DAMAGED),
    "text for a number": (saved(displacement_mm="300"), DAMAGED),
    "a yes for a number": (saved(displacement_mm=True), DAMAGED),
    "not a number": (saved(displacement_mm=float("nan")), DAMAGED),
    "infinite": (saved(sigma_mm=float("inf")), DAMAGED),
    "negative sigma": (saved(sigma_mm=-1), DAMAGED),
    "larger than any": (saved()[:-1] + " " * LARGEST_FILE_BYTES + "}", DAMAGED),
    "learned damaged": (saved_with(mean=[0.0]), DAMAGED),
    "learned not positive definite": (saved_with(covariance=[[1e-6] * 6] * 6), DAMAGED),
    "learned not a number": (saved_with(noise_m=float("nan")), DAMAGED),
    "learned of another version": (saved_with(names=["scale"], mean=[-0.02], covariance=[[1e-6]]), DAMAGED),
    "other format": (saved(format=3), "is of another version (format 3, not 2)"),
    "other stroke": (saved(stroke_mm=600), "is of another machine: its stroke is 600 mm, not 500 mm"),
    "learned at another stroke": (of_machine(stroke_m=0.6), "on another machine (its stroke is 600 mm, not 500 mm)"),
    "learned at another speed": (
        of_machine(push_speed_m_s=0.020),
        "on another machine (its nominal push speed is 20 mm/s, not 14.53 mm/s)",
    ),
    "learned from another signal": (
        of_machine(displacement_signal="Position.position, 17.5 ms old"),
        "on another machine (its displacement signal is 'Position.position, 17.5 ms old', "
        "not 'SupportStatus.ram_stroke, 17.5 ms old')",
    ),
    "learned beyond belief": (
        saved_with(mean=[0.4, *MEAN[1:]]),
        "cannot be used: its scale of 0.4 cannot have been learned from -0.015",
    ),
    "stroke beyond the stop": (saved(displacement_mm=1e300), "holds an impossible stroke"),
    "stroke before the stop": (saved(displacement_mm=-200), "holds an impossible stroke"),
}


@pytest.mark.parametrize("what", USELESS)
def test_a_useless_file_leaves_nothing_known_and_the_log_says_why_in_one_sentence(
    what: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text, reason = USELESS[what]
    path = tmp_path / "state.json"
    path.write_text(text)
    with caplog.at_level(logging.WARNING):
        assert load(path, SETTINGS, NOW_S) == Start()
    (line,) = caplog.messages
    assert line.startswith(str(path))
    assert line.endswith(reason + NOTHING)
    assert "\n" not in line


USELESS_STROKES: dict[str, tuple[dict[str, Any], str]] = {
    "in a move": ({"at_rest": False}, "was saved during a move"),
    "years ago": ({"wall_time_s": 1.0}, "is too old or was too uncertain"),
    "huge sigma": ({"sigma_mm": 1e300}, "is too old or was too uncertain"),
    "from the future": ({"wall_time_s": NOW_S + 3600}, "the computer's clock is not to be trusted"),
}


@pytest.mark.parametrize("what", USELESS_STROKES)
def test_a_useless_stroke_takes_nothing_from_what_was_learned(
    what: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    changes, reason = USELESS_STROKES[what]
    path = tmp_path / "state.json"
    save(path, CALIBRATED.model_copy(update=changes))
    with caplog.at_level(logging.WARNING):
        start = load(path, SETTINGS, NOW_S)
    (line,) = caplog.messages
    assert reason in line
    assert line.endswith(": the stroke is undetermined")
    assert start == Start(learned=start.learned)
    assert start.learned is not None
    assert start.learned.calibrations == 7


def test_a_first_start_says_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert load(tmp_path / "state.json", SETTINGS) == Start()
    assert caplog.messages == []


def test_what_cannot_be_read_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert load(tmp_path, SETTINGS) == Start()
    assert caplog.messages == [f"{tmp_path} cannot be read (Is a directory){NOTHING}"]


def test_what_was_learned_survives_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    save(path, CALIBRATED)
    assert read(path, SETTINGS) == CALIBRATED
    # Saved this very moment: nothing is lost; the stroke may be believed.
    start = load(path, SETTINGS, CALIBRATED.wall_time_s)
    assert start.learned == CALIBRATED.learned
    assert start.only_without_sensor


def test_what_was_learned_is_loaded_with_the_doubt_of_the_time_between(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    save(path, CALIBRATED)
    sigmas = []
    for days in (0, 1, 30, 1000):
        learned = load(path, SETTINGS, CALIBRATED.wall_time_s + days * 86_400).learned
        assert learned is not None
        sigmas.append(learned.push.sigma_m_s)
    assert sigmas == sorted(sigmas)
    # A day adds 0.3 % of the speed in quadrature (a prior of 2 %, forgotten in 90 days), endless time leaves the prior.
    assert sigmas[1] == pytest.approx(hypot(sigmas[0], 0.003 * 0.01453), rel=0.02)
    assert sigmas[3] == pytest.approx(0.02 * 0.01453, rel=0.001)


def test_a_clock_that_went_back_counts_as_a_week(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    save(path, CALIBRATED)
    back = load(path, SETTINGS, 1.0)
    week = load(path, SETTINGS, CALIBRATED.wall_time_s + 7 * 86_400)
    assert back.learned == week.learned
    assert back.learned != CALIBRATED.learned


def test_a_file_of_format_1_still_tells_the_stroke(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "state.json"
    path.write_text(
        f'{{"format": 1, "wall_time_s": {NOW_S - 3600}, "stroke_mm": 500.0, "displacement_mm": 300.0, '
        '"sigma_mm": 2.0, "at_rest": true}'
    )
    assert load(path, SETTINGS, NOW_S) == AT_300.start(SETTINGS, NOW_S)
    assert caplog.messages == []


def test_another_inertial_part_and_a_corrected_nominal_speed_void_nothing(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    here = machine_of(SETTINGS)
    for changes in (
        {"inertial_part": "ADIS16448 lot 00000001 serial 2"},
        {"push_speed_m_s": 0.0148},
        {"displacement_signal": ""},
    ):
        learned = learned_of(here.model_copy(update=changes))
        save(path, CALIBRATED.model_copy(update={"learned": learned}))
        assert load(path, SETTINGS, CALIBRATED.wall_time_s).learned == learned


def test_without_can_what_was_learned_of_its_sensor_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    save(path, CALIBRATED)
    without = Settings.model_validate({"can": {"enabled": False}})
    start = load(path, without, CALIBRATED.wall_time_s)
    stream = Stream(without, lambda _topic, _record: None, start)
    assert stream.learned() == CALIBRATED.learned  # the name of its signal included


@pytest.mark.parametrize(
    ("displacement", "signal"),
    [
        ({}, "SupportStatus.ram_stroke, 17.5 ms old"),
        ({"latency_ms": 20}, "SupportStatus.ram_stroke, 20 ms old"),
        ({"arbitration_id": 0x312}, "SupportStatus.ram_stroke on 0x312, 17.5 ms old"),
        ({"preset": "cia406", "node_id": 5}, "Position.position of node 5, 17.5 ms old"),
        ({"dbc": "own.dbc", "message": "m", "signal": "s"}, "m.s, 17.5 ms old"),
    ],
)
def test_a_displacement_signal_is_told_from_others(displacement: dict[str, Any], signal: str) -> None:
    settings = Settings.model_validate({"can": {"displacement": displacement}})
    assert machine_of(settings).displacement_signal == signal


@settings(derandomize=True, deadline=None, max_examples=200)
@given(st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_no_bytes_whatever_stop_the_start(data: bytes) -> None:
    assert loaded(data) == Start()


def loaded(data: bytes) -> Start:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "state.json"
        path.write_bytes(data)
        return load(path, SETTINGS, NOW_S)


WHOLE = json.dumps(CALIBRATED.model_dump()).encode()


@st.composite
def with_bytes_exchanged(draw: st.DrawFn) -> bytes:
    at = draw(st.integers(0, len(WHOLE) - 1))
    return WHOLE[:at] + draw(st.binary(max_size=8)) + WHOLE[at + draw(st.integers(0, 8)) :]


@st.composite
def with_a_value_exchanged(draw: st.DrawFn) -> bytes:
    tree = json.loads(WHOLE)
    place: Any = tree
    key: Any = draw(st.sampled_from(["learned"] * 9 + ["displacement_mm", "at_rest", "format"]))
    while isinstance(place[key], dict | list):
        place = place[key]
        key = draw(st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place))))
    odd: st.SearchStrategy[Any] = st.sampled_from(
        [None, [], {}, "", "1", True, math.nan, math.inf, 1e300, -1e300, 1e-300, 0, -1]
    )
    place[key] = draw(odd | st.floats())
    return json.dumps(tree).encode()


@settings(derandomize=True, deadline=None, max_examples=500)
@given(with_bytes_exchanged() | with_a_value_exchanged())
def test_a_damaged_file_is_refused_or_of_use_as_a_whole(data: bytes) -> None:
    """Some damage makes another good number; with whatever is accepted an estimator can begin."""
    start = loaded(data)
    Pipeline(start=start)
    if start.learned is not None:
        p = np.array(start.learned.covariance)
        assert np.isfinite(p).all()
        assert np.linalg.eigvalsh(p / np.sqrt(np.outer(np.diag(p), np.diag(p)))).min() > 0


@pytest.mark.parametrize("length", range(0, len(WHOLE), 97))
def test_a_file_cut_anywhere_is_refused(length: int) -> None:
    assert loaded(WHOLE[:length]) == Start()


@settings(derandomize=True, deadline=None)
@given(
    sigma_mm=st.floats(0, 1e308),
    wall_time_s=st.floats(0, 1e308),
    displacement_mm=st.floats(-1e308, 1e308),
)
def test_no_numbers_claim_more_than_was_known(sigma_mm: float, wall_time_s: float, displacement_mm: float) -> None:
    start = SavedState(
        wall_time_s=wall_time_s,
        stroke_mm=500,
        displacement_mm=displacement_mm,
        sigma_mm=sigma_mm,
        at_rest=True,
    ).start(SETTINGS, NOW_S)
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
    assert load(path, SETTINGS, NOW_S).displacement_m == pytest.approx(0.222)
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


def test_a_refused_file_is_kept_beside_and_never_saved_over(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    save(path, AT_300.model_copy(update={"stroke_mm": 700}))
    refused = path.read_bytes()
    assert load(path, SETTINGS, NOW_S) == Start()
    aside = tmp_path / "state.json.refused"
    assert aside.read_bytes() == refused
    save(path, AT_300)
    path.write_text("{")
    assert load(path, SETTINGS, NOW_S) == Start()
    assert aside.read_bytes() == refused  # the first one, which may hold more than what came after


def test_a_pipe_in_place_of_the_file_is_told_instead_of_waited_for(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "state.json"
    os.mkfifo(path)
    assert load(path, SETTINGS, NOW_S) == Start()
    assert f"{path} is a pipe, no file" in caplog.text
