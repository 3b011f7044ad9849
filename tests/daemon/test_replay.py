"""`ramstroke replay`: the same bytes again from what was received, and what can be written of them."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from daemon.cli import main
from daemon.machine import machine_of
from daemon.offline.replaying.replay import replay
from daemon.recording import topics
from daemon.recording.metadata import LEARNED, SNAPSHOT, Preamble, describe
from daemon.recording.reader import Recording
from daemon.recording.recorder import Recorder
from daemon.recording.settings import RecorderSettings
from daemon.recording.topics import TOPICS, Recorded
from daemon.recording.writer import RecordingWriter
from daemon.service import state_file
from daemon.settings import Settings
from daemon.simulation.demo import demo_settings
from daemon.simulation.run import SimulatedRun
from daemon.simulation.virtual import virtual_support
from daemon.stream import Sink, Stream
from drivers.adis16448.identity import Identity
from drivers.can.frame import Frame
from drivers.clock import VirtualClock
from estimation.learned import Learned
from estimation.pipeline import Start
from estimation.records import Estimate, Segment, Tick
from tests.conftest import DemoRun
from tests.estimation.learned_kit import learned_of

CONTROLLER_ID = 0x310
ESTIMATES = (topics.PROVISIONAL, topics.SETTLED)
COLUMNS = [
    "t_s",
    "displacement_mm",
    "sigma_mm",
    "velocity_mm_s",
    "velocity_sigma_mm_s",
    "segment",
    "tier",
    "can_state",
]
MOVE_KEYS = {
    "kind",
    "onset_s",
    "stop_s",
    "start_mm",
    "end_mm",
    "end_before_stop_mm",
    "sigma_mm",
    "sigma_before_stop_mm",
    "velocity_mm_s",
    "can_state",
    "tier",
}


ELSEWHERE = {"displacement_mm": 400.0}


def estimates_in(path: Path, topic: str) -> list[Estimate]:
    return [record for _, record in Recording(path).messages((topic,)) if isinstance(record, Estimate)]


def replayed(capsys: pytest.CaptureFixture[str], path: Path, *options: str) -> dict[str, Any]:
    """Run the command with --json."""
    assert main(["replay", str(path), "--json", *options]) == 0
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


def rewrite(
    source: Path, target: Path, change: Callable[[str, Recorded], Recorded | None], seconds: float = math.inf
) -> Path:
    """A copy with every message as `change` wants it (None: left out), up to `seconds`."""
    recording = Recording(source)
    with RecordingWriter(target, recording.metadata, recording.attachments) as writer:
        for topic, record in recording.messages():
            if TOPICS[topic].time_ns(record) > seconds * 1e9:
                break
            changed = change(topic, record)
            if changed is not None:
                writer.write(topic, changed)
    return target


@pytest.fixture(scope="module")
def short(demo_run: DemoRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first 12 s of the demo; its push begins at 10 s."""
    target = tmp_path_factory.mktemp("replay") / "short.mcap"
    return rewrite(demo_run.recording, target, lambda _, record: record, seconds=12)


def test_the_demo_is_reproduced_bit_for_bit(demo_run: DemoRun, capsys: pytest.CaptureFixture[str]) -> None:
    report = replayed(capsys, demo_run.recording)
    assert report["identical"] is True
    assert report["samples"] == len(list(Recording(demo_run.recording).messages((topics.IMU_RAW,))))
    assert report["duration_s"] == pytest.approx(report["samples"] / 819.2, rel=0.04)
    assert report["realtime_factor"] > 1
    assert report["damage"] == []
    assert [move["kind"] for move in report["moves"]] == ["push", "retract"]
    for move, shown in zip(report["moves"], demo_run.report["moves"], strict=True):
        assert move.keys() == MOVE_KEYS
        assert move == {key: shown[key] for key in MOVE_KEYS}
        assert all(isinstance(move[key], float) for key in MOVE_KEYS - {"kind", "can_state", "tier"})


@pytest.mark.parametrize("topic", ESTIMATES)
@pytest.mark.parametrize("place", [0, 700])
def test_one_estimate_that_differs_in_its_last_bit_is_seen(topic: str, place: int, short: Path, tmp_path: Path) -> None:
    number = -1

    def alter(of: str, record: Recorded) -> Recorded:
        nonlocal number
        if of == topic and isinstance(record, Estimate):
            number += 1
            if number == place:
                return replace(record, displacement_m=math.nextafter(record.displacement_m, math.inf))
        return record

    assert replay(rewrite(short, tmp_path / "altered.mcap", alter)).identical is False


def test_an_estimate_that_nothing_brings_about_is_seen(short: Path, tmp_path: Path) -> None:
    target = tmp_path / "more.mcap"
    recording = Recording(short)
    with RecordingWriter(target, recording.metadata, recording.attachments) as writer:
        for topic, record in recording.messages():
            writer.write(topic, record)
        # Settled ones of the last seconds are yet to come; this many are not.
        settled = estimates_in(short, topics.SETTLED)
        for _ in range(1000):
            writer.write(topics.SETTLED, settled[-1])
    assert replay(target).identical is False


def test_a_lost_input_is_seen(short: Path, tmp_path: Path) -> None:
    seen = 0

    def lose(_: str, record: Recorded) -> Recorded | None:
        nonlocal seen
        if isinstance(record, Frame) and record.arbitration_id == CONTROLLER_ID:
            seen += 1
            return None if seen == 40 else record
        return record

    altered = rewrite(short, tmp_path / "lost.mcap", lose)
    assert seen > 100
    assert replay(altered).identical is False


def test_without_recorded_estimates_there_is_nothing_to_compare(short: Path, tmp_path: Path) -> None:
    bare = rewrite(short, tmp_path / "bare.mcap", lambda topic, r: None if topic in ESTIMATES else r)
    result = replay(bare)
    assert result.identical is None
    assert result.samples == replay(short).samples > 9000


def test_an_import_has_no_estimates_to_reproduce(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, imported, again = (tmp_path / name for name in ("rest.csv", "rest.mcap", "again.mcap"))
    config = tmp_path / "bench.toml"
    config.write_text("[support]\ninitial_mm = 120\n")
    header = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
    rows = [f"{number / 200:.3f},0.001,-0.002,0,{number % 3 * 0.01},0,9.81" for number in range(1000)]
    table.write_text("\n".join([header, *rows]) + "\n")
    assert main(["import", str(table), "-o", str(imported), "--config", str(config)]) == 0
    capsys.readouterr()
    report = replayed(capsys, imported, "-o", str(again))
    assert report["identical"] is None
    assert (report["samples"], report["moves"]) == (1000, [])
    assert report["duration_s"] == pytest.approx(4.995)
    estimates = estimates_in(again, topics.SETTLED)
    assert estimates[0].segment is Segment.ZUPT
    assert [e.displacement_m for e in estimates] == pytest.approx([0.120] * (1000 // 8), abs=1e-3)
    # What the replay wrote now has estimates, and they come out again.
    assert replayed(capsys, again)["identical"] is True
    # From a state file only what was learned is taken: where the ram stood, the configuration knows.
    state = tmp_path / "state.json"
    learned = learned_of(machine_of(Settings()))
    state_file.save(state, state_file.SavedState.of(estimates[0], learned, 500, 1e9).model_copy(update=ELSEWHERE))
    report = replayed(capsys, imported, "--state", str(state), "-o", str(again))
    assert report["learned"]["push"]["moves"] == learned.pushes
    assert estimates_in(again, topics.SETTLED)[-1].displacement_m == pytest.approx(0.120, abs=1e-3)
    assert replayed(capsys, again)["identical"] is True


@pytest.mark.parametrize("share", [0.2, 0.55, 0.9])
def test_a_cut_file_is_reproduced_as_far_as_it_goes(share: float, short: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    data = short.read_bytes()
    cut.write_bytes(data[: int(share * len(data))])
    result, whole = replay(cut), replay(short)
    assert result.identical is True
    assert 0 < result.samples < whole.samples
    assert result.damage[-1].startswith("the index at the end is missing: the file was cut")


def table_of(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    with path.open(newline="") as stream:
        rows = csv.DictReader(stream)
        return list(rows.fieldnames or ()), list(rows)


@pytest.mark.parametrize("tier", ["settled", "provisional"])
def test_the_table_has_a_row_for_every_step(
    tier: str, short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "steps.csv"
    replayed(capsys, short, "--csv", str(path), *(["--provisional"] if tier == "provisional" else []))
    columns, rows = table_of(path)
    assert columns == COLUMNS
    written: list[Estimate] = []

    def sink(topic: str, record: Recorded) -> None:
        if isinstance(record, Estimate) and record.tier == tier:
            written.append(record)

    result = replay(short, sink=sink)
    assert len(rows) == len(written) == result.samples // 8
    assert {row["tier"] for row in rows} == {tier}
    assert rows[0]["segment"] == "ZUPT"
    assert {row["segment"] for row in rows} >= {"ZUPT", "VVS"}
    for row, estimate in zip(rows, written, strict=True):
        assert round(float(row["t_s"]) * 1e9) == pytest.approx(estimate.t_ns, abs=2)
        assert float(row["displacement_mm"]) == pytest.approx(estimate.displacement_m * 1e3, abs=1e-6)
        assert float(row["sigma_mm"]) == pytest.approx(estimate.sigma_m * 1e3, abs=1e-6)
        assert float(row["velocity_mm_s"]) == pytest.approx(estimate.velocity_m_s * 1e3, abs=1e-6)
        assert float(row["velocity_sigma_mm_s"]) == pytest.approx(estimate.velocity_sigma_m_s * 1e3, abs=1e-6)
        assert (row["segment"], row["can_state"]) == (estimate.segment, estimate.can_state)
    times = [row["t_s"] for row in rows]
    assert times == sorted(times, key=float)


def test_settled_rows_know_the_onset_that_provisional_ones_learned_later(
    demo_run: DemoRun, short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    onset_s = demo_run.report["moves"][0]["onset_s"]
    first_moving: dict[str, float] = {}
    for tier, option in (("settled", []), ("provisional", ["--provisional"])):
        path = tmp_path / f"{tier}.csv"
        replayed(capsys, short, "--csv", str(path), *option)
        first_moving[tier] = next(float(row["t_s"]) for row in table_of(path)[1] if row["segment"] != "ZUPT")
    # The settled start is the onset, less what the acceleration may have been under way before it.
    assert onset_s - 0.3 < first_moving["settled"] < onset_s + 0.02
    assert onset_s + 0.02 < first_moving["provisional"] < onset_s + 2


def test_the_recording_that_a_replay_writes_replays_too(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    once, twice = tmp_path / "once.mcap", tmp_path / "twice.mcap"
    assert replayed(capsys, short, "-o", str(once))["identical"] is True
    assert replayed(capsys, once, "-o", str(twice))["identical"] is True
    for path in (once, twice):
        assert Recording(path).metadata == Recording(short).metadata
    for topic in TOPICS:
        messages = [list(Recording(path).messages((topic,))) for path in (once, twice)]
        encoded = [[TOPICS[topic].encode(record) for _, record in of] for of in messages]
        assert encoded[0] == encoded[1], topic


def test_other_settings_give_other_estimates_and_are_written_down(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, output = tmp_path / "other.toml", tmp_path / "other.mcap"
    config.write_text("[support]\nstroke_mm = 700\n[estimator]\ncan_noise_mm = 9\n")
    before = replayed(capsys, short)
    report = replayed(capsys, short, "--config", str(config), "-o", str(output))
    assert (before["identical"], report["identical"]) == (True, False)
    assert report["samples"] == before["samples"]
    written = Settings.model_validate_json(Recording(output).metadata["settings"])
    assert (written.support.stroke_mm, written.estimator.can_noise_mm) == (700, 9)
    # The stroke at the start is undetermined now, until a reading with 9 mm of noise comes.
    assert estimates_in(output, topics.PROVISIONAL)[0].sigma_m > 5 * estimates_in(short, topics.PROVISIONAL)[0].sigma_m
    assert replayed(capsys, output)["identical"] is True


def test_people_are_told_whether_it_was_reproduced(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(short)]) == 0
    printed = capsys.readouterr()
    assert "recorded estimates: reproduced bit for bit" in printed.out
    assert "No moves were found." in printed.out
    assert printed.err == ""


def test_the_recording_itself_is_never_overwritten(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = short.read_bytes()
    for option in ("-o", "--csv"):
        assert main(["replay", str(short), option, str(short)]) == 1
        assert capsys.readouterr().err == (
            f"ramstroke: {short} is the file to read from: name another file for the result\n"
        )
    assert short.read_bytes() == before


def test_outputs_that_cannot_be_written_are_told_and_leave_nothing(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    for option in ("-o", "--csv"):
        for place, reason in (
            ("none/x", "No such file or directory"),
            ("file/x", "Not a directory"),
        ):
            target = tmp_path / place
            assert main(["replay", str(short), option, str(target)]) == 1
            assert capsys.readouterr().err == f"ramstroke: cannot write {target}: {reason}\n"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_replay_that_fails_leaves_no_half_table(short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Stream, "finish", interrupt)
    table, output = tmp_path / "x.csv", tmp_path / "x.mcap"
    assert main(["replay", str(short), "--csv", str(table), "-o", str(output)]) == 130
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("settings", "snapshot", "sentence"),
    [
        (None, b"", "does not say with which settings it was made: name --config FILE"),
        ('{"imu": {"colour": 1}}', b"", "was made with settings of another version: name --config FILE"),
        ("not JSON", b"", "was made with settings of another version: name --config FILE"),
        (
            "{}",
            b"damaged",
            "its snapshot is damaged or of another version: name --config FILE to start afresh",
        ),
    ],
)
def test_a_recording_of_another_version_asks_for_a_configuration(
    settings: str | None,
    snapshot: bytes,
    sentence: str,
    short: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path, config = tmp_path / "foreign.mcap", tmp_path / "own.toml"
    config.write_text("")
    metadata = dict(Recording(short).metadata)
    del metadata["settings"]
    with RecordingWriter(
        path, metadata if settings is None else metadata | {"settings": settings}, {SNAPSHOT: snapshot}
    ) as writer:
        for number, (topic, record) in enumerate(Recording(short).messages((topics.IMU_RAW,))):
            writer.write(topic, record)
            if number == 800:
                break
    assert main(["replay", str(path)]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"ramstroke: {path}")
    assert said.endswith(f"{sentence}\n")
    assert main(["replay", str(path), "--config", str(config)]) == 0


# --- what was learned ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Halves:
    """The demo, cut in the rest between push and retract."""

    first: Path
    second: Path


@pytest.fixture(scope="module")
def halves(demo_run: DemoRun, tmp_path_factory: pytest.TempPathFactory) -> Halves:
    folder = tmp_path_factory.mktemp("halves")
    cut_s = sum(demo_run.report["moves"][i][key] for i, key in enumerate(("stop_s", "onset_s"))) / 2

    def late(topic: str, record: Recorded) -> Recorded | None:
        return record if TOPICS[topic].time_ns(record) > cut_s * 1e9 else None

    return Halves(
        rewrite(demo_run.recording, folder / "first.mcap", lambda _, record: record, seconds=cut_s),
        rewrite(demo_run.recording, folder / "second.mcap", late),
    )


def test_two_halves_with_the_state_between_are_measured_as_well_as_the_whole(
    halves: Halves, demo_run: DemoRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = str(tmp_path / "state.json")
    first = replayed(capsys, halves.first, "--save-state", state)
    assert first["identical"] is True
    assert (first["learned"]["push"]["moves"], first["learned"]["retract"]["moves"]) == (1, 0)
    # From the state and into the state, as a chain of files is replayed.
    second = replayed(capsys, halves.second, "--state", state, "--save-state", state)
    afresh = replayed(capsys, halves.second, "--config", str(empty_config(tmp_path)))
    assert second["identical"] is None
    assert second["learned"]["sensor"]["calibrations"] == 2
    (retract,), (new,), whole = second["moves"], afresh["moves"], demo_run.report["moves"][1]
    assert retract["kind"] == new["kind"] == "retract"
    assert retract["sigma_before_stop_mm"] < 1.1 * whole["sigma_before_stop_mm"]
    assert new["sigma_before_stop_mm"] > 1.3 * whole["sigma_before_stop_mm"]
    assert abs(retract["end_before_stop_mm"] - whole["truth_mm"]) < 2.5 * retract["sigma_before_stop_mm"]
    # What both halves learned is what the whole teaches.
    learned, at_once = second["learned"], replayed(capsys, demo_run.recording)["learned"]
    for part, value, sigma in (
        ("push", "speed_mm_s", "sigma_mm_s"),
        ("retract", "speed_mm_s", "sigma_mm_s"),
        ("sensor", "scale_percent", "scale_sigma_percent"),
        ("sensor", "offset_mm", "offset_sigma_mm"),
    ):
        assert learned[part][sigma] == pytest.approx(at_once[part][sigma], rel=0.15)
        assert abs(learned[part][value] - at_once[part][value]) < at_once[part][sigma]


def empty_config(folder: Path) -> Path:
    path = folder / "defaults.toml"
    path.write_text("")
    return path


def test_people_are_told_what_was_learned_and_that_nothing_is_compared(
    short: Path, halves: Halves, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = str(tmp_path / "state.json")
    assert main(["replay", str(short)]) == 0
    assert "learned: nothing learned yet\n" in capsys.readouterr().out
    assert main(["replay", str(halves.first), "--save-state", state]) == 0
    capsys.readouterr()
    assert main(["replay", str(short), "--state", state]) == 0
    said = capsys.readouterr().out
    assert "recorded estimates: not compared\n" in said
    assert re.search(
        r"learned: push 1\d\.\d\d ± 0\.\d\d mm/s \(from 1 move\), retract .* \(from 0 moves\), sensor", said
    )


def test_what_a_replay_from_a_state_writes_replays_by_itself(
    short: Path, halves: Halves, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state, output = tmp_path / "state.json", tmp_path / "out.mcap"
    replayed(capsys, halves.first, "--save-state", str(state))
    from_state = replayed(capsys, short, "--state", str(state), "-o", str(output))
    report = replayed(capsys, output)
    assert report["identical"] is True
    assert report["learned"] == from_state["learned"]
    started = Learned.model_validate_json(Recording(output).attachments[LEARNED])
    saved = state_file.read(state, Settings()).learned
    assert saved is not None
    assert (started.names, started.pushes) == (saved.names, saved.pushes)
    for name in started.names:  # an hour's doubt at most was added
        assert started.value(name) == pytest.approx(saved.value(name), rel=1e-2)


def headed(source: Path, target: Path, attachments: dict[str, bytes]) -> Path:
    """A copy with another head."""
    recording = Recording(source)
    with RecordingWriter(target, recording.metadata, attachments) as writer:
        for topic, record in recording.messages((topics.IMU_RAW, topics.CAN_RX)):
            writer.write(topic, record)
    return target


def test_without_a_snapshot_a_replay_begins_with_what_was_learned(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = learned_of(machine_of(demo_settings(1)))
    path = headed(short, tmp_path / "headed.mcap", {LEARNED: known.model_dump_json().encode()})
    report = replayed(capsys, path)
    assert report["learned"]["push"]["moves"] == known.pushes
    assert report["learned"]["push"]["speed_mm_s"] == pytest.approx(known.push.speed_m_s * 1e3, rel=1e-3)
    afresh = replayed(capsys, path, "--config", str(empty_config(tmp_path)))
    assert afresh["learned"] is None


@pytest.mark.parametrize(
    "learned",
    [
        b"",
        b"learned",
        b'{"rate_hz": 815.25}',
        learned_of(machine_of(demo_settings(1)).model_copy(update={"stroke_m": 0.7})).model_dump_json().encode(),
    ],
)
def test_a_learned_state_that_cannot_be_used_asks_for_a_configuration(
    learned: bytes, short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = headed(short, tmp_path / "headed.mcap", {LEARNED: learned})
    assert main(["replay", str(path)]) == 1
    assert capsys.readouterr().err == (
        f"ramstroke: {path}: its learned state is damaged or of another version: name --config FILE to start afresh\n"
    )
    assert main(["replay", str(path), "--config", str(empty_config(tmp_path))]) == 0
    # Beside a snapshot, which holds everything, it is not needed.
    whole = headed(short, tmp_path / "whole.mcap", {LEARNED: learned, SNAPSHOT: Recording(short).attachments[SNAPSHOT]})
    assert main(["replay", str(whole)]) == 0


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "does not exist: name a state file, or write one with --save-state"),
        (b"", "is damaged or of another version"),
        (b'{"format": 2}', "is damaged or of another version"),
        (
            b'{"format": 1, "wall_time_s": 1, "stroke_mm": 600, "displacement_mm": 1, "sigma_mm": 1, "at_rest": true}',
            "is of another machine: its stroke is 600 mm, not 500 mm",
        ),
    ],
)
def test_a_state_that_cannot_be_used_is_wrong_usage(
    content: bytes | None, said: str, short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state, output = tmp_path / "state.json", tmp_path / "out.mcap"
    if content is not None:
        state.write_bytes(content)
    for options in ([], ["-o", str(output)]):
        assert main(["replay", str(short), "--state", str(state), *options]) == 2
        assert capsys.readouterr() == ("", f"ramstroke: {state} {said}\n")
    assert not output.exists()


def test_a_state_that_cannot_be_written_is_wrong_usage(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    for target, said in (
        (tmp_path / "file" / "x", f"cannot write {tmp_path}/file/x: File exists"),
        (tmp_path, f"cannot write {tmp_path}: Is a directory"),
        (short, f"{short} is the file to read from: name another file for the state"),
    ):
        assert main(["replay", str(short), "--save-state", str(target)]) == 2
        assert capsys.readouterr() == ("", f"ramstroke: {said}\n")
    bare = headed(short, tmp_path / "bare.mcap", {})
    with RecordingWriter(bare, Recording(short).metadata) as writer:
        writer.write(topics.TICK, Tick(0))
    assert main(["replay", str(bare), "--save-state", str(tmp_path / "s.json")]) == 2
    assert capsys.readouterr().err.startswith(f"ramstroke: {bare} brings about no estimate: ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bare.mcap", "file"]
    assert not list(tmp_path.parent.glob(".*.part"))


def test_a_recording_that_does_not_say_when_it_was_made_can_be_begun_from_a_state(
    short: Path, halves: Halves, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = str(tmp_path / "state.json")
    replayed(capsys, halves.first, "--save-state", state)
    for number, created in enumerate((None, "yesterday", "0001-01-01T00:00:00")):
        metadata = dict(Recording(short).metadata)
        del metadata["created"]
        path = tmp_path / f"{number}.mcap"
        with RecordingWriter(path, metadata if created is None else metadata | {"created": created}) as writer:
            for topic, record in islice(Recording(short).messages((topics.IMU_RAW,)), 2000):
                writer.write(topic, record)
        report = replayed(capsys, path, "--state", state, "--save-state", state)
        assert report["learned"]["push"]["moves"] == 1


# --- a run in simulated time, recorded by the real recorder ----------------------------------------------------


def simulate(settings: Settings, seconds: float, sink: Callable[[Stream], Sink]) -> None:
    """The program's own driver and bus on the twins, into a stream whose sink is made by `sink`."""
    clock = VirtualClock()
    run = SimulatedRun.of(settings, virtual_support(settings, cycles=1), clock)
    receive: list[Sink] = []
    stream = Stream(settings, lambda topic, record: receive[0](topic, record), Start(0.0))
    receive.append(sink(stream))
    try:
        while clock.now_ns() < seconds * 1e9 and (received := run.next()) is not None:
            block, frames = received
            for record in block:
                stream.take(topics.IMU_IDENTITY if isinstance(record, Identity) else topics.IMU_RAW, record)
            for frame in frames:
                stream.take(topics.CAN_RX, frame)
        stream.finish()
    finally:
        run.close()


def changed(settings: Settings, **sections: dict[str, Any]) -> Settings:
    tree = settings.model_dump(mode="json")
    for name, values in sections.items():
        tree[name] |= values
    return Settings.model_validate(tree)


def preamble(settings: Settings, stream: Stream) -> Preamble:
    return Preamble(describe("recording", settings.model_dump_json()), stream.attachments())


@pytest.mark.parametrize("block_samples", [1, 8, 13, 64])
def test_a_run_with_blocks_of_any_size_is_reproduced(block_samples: int, tmp_path: Path) -> None:
    """Block by block other frames come between other samples; their order is what counts."""
    settings = changed(demo_settings(3), imu={"block_samples": block_samples})
    path = tmp_path / "run.mcap"
    with ExitStack() as stack:

        def sink(stream: Stream) -> Sink:
            head = preamble(settings, stream)
            return stack.enter_context(RecordingWriter(path, head.metadata, head.attachments)).write

        simulate(settings, 4, sink)
    result = replay(path)
    assert result.identical is True
    assert result.samples > 3000


def test_blocks_of_any_size_change_nothing_but_the_place_of_frames(tmp_path: Path) -> None:
    def estimates(block_samples: int) -> list[bytes]:
        taken: list[bytes] = []
        settings = changed(
            demo_settings(3), imu={"block_samples": block_samples}, can={"enabled": False, "reference": None}
        )

        def sink(_: Stream) -> Sink:
            return lambda topic, record: taken.append(TOPICS[topic].encode(record))

        simulate(settings, 4, sink)
        return taken

    ones = estimates(1)
    for size in (8, 13, 64):
        others = estimates(size)
        # The larger the blocks, the later the last one ends; `finish` settles what comes before.
        assert len(others) >= len(ones) > 3300
        assert others[:3300] == ones[:3300]


def test_each_file_of_a_rotated_recording_is_reproduced_alone(tmp_path: Path) -> None:
    settings = demo_settings(2)
    # Cut by the recorder's own clock, here a simulated one: about every three seconds of the run.
    recorder_settings = RecorderSettings(directory=tmp_path, rotate_minutes=0.05, flush_interval_ms=1)
    clock = VirtualClock()
    recorders: list[Recorder] = []
    inputs: list[bytes] = []

    def sink(stream: Stream) -> Sink:
        recorder = Recorder(recorder_settings, lambda: preamble(settings, stream), clock=clock)
        recorder.start()
        recorders.append(recorder)

        def receive(topic: str, record: Recorded) -> None:
            if topic in (topics.IMU_RAW, topics.CAN_RX):
                inputs.append(TOPICS[topic].encode(record))
                clock.advance_to(TOPICS[topic].time_ns(record))
            while recorder.queued > 2000:  # simulated time runs faster than any disk
                clock.sleep(0)
            recorder.write(topic, record)

        return receive

    simulate(settings, 16, sink)
    assert recorders[0].close()
    counters = recorders[0].counters
    assert (counters.dropped, counters.errors) == (0, 0)
    files = sorted(tmp_path.iterdir(), key=lambda path: path.stat().st_mtime_ns)
    assert len(files) == counters.files >= 4
    kept: list[bytes] = []
    for path in files:
        result = replay(path)
        assert (result.identical, result.damage) == (True, []), path
        assert path == files[-1] or result.samples > 1000
        kept += [
            TOPICS[topic].encode(record) for topic, record in Recording(path).messages((topics.IMU_RAW, topics.CAN_RX))
        ]
    assert kept == inputs


def test_a_rotated_file_starts_where_the_stroke_was(tmp_path: Path, demo_run: DemoRun) -> None:
    """A snapshot in the middle of the push, not the beginning's."""
    settings = demo_settings(1)
    sink: list[tuple[str, Recorded]] = []
    stream = Stream(settings, lambda topic, record: sink.append((topic, record)), Start(0.0))

    def inputs() -> Iterator[tuple[str, Recorded]]:
        for topic, record in Recording(demo_run.recording).messages((topics.IMU_RAW, topics.CAN_RX)):
            if TOPICS[topic].time_ns(record) > 22e9:
                return
            yield topic, record

    received = inputs()
    for topic, record in received:
        stream.take(topic, record)
        if TOPICS[topic].time_ns(record) > 20e9:
            break
    head = preamble(settings, stream)
    sink.clear()
    for topic, record in received:
        stream.take(topic, record)
    stream.finish()
    path = tmp_path / "second.mcap"
    with RecordingWriter(path, head.metadata, head.attachments) as writer:
        for topic, record in sink:
            writer.write(topic, record)
    result = replay(path)
    assert result.identical is True
    provisional = estimates_in(path, topics.PROVISIONAL)
    assert 0.1 < provisional[0].displacement_m < 0.2
    assert {e.segment for e in provisional} == {Segment.CVS}
