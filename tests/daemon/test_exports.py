"""`ramstroke review --csv, --parquet, --png`: tables read back and compared with the recording; pictures."""

from __future__ import annotations

import csv
import errno
import json
import struct
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from daemon.cli import main
from daemon.extras import needs
from daemon.offline.exports import pictures
from daemon.offline.exports.csv_tables import CsvWriter
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import Health, LogLine
from daemon.recording.writer import RecordingWriter
from daemon.stream import Stream

REGRESSION = Path(__file__).parent.parent / "data" / "regression"
PARTIAL = REGRESSION / "partial_push_and_retract.mcap"
SICK = REGRESSION / "another_sensor_and_a_sick_bus.mcap"
TABLES = {"steps", "moves", "displacement", "events", "log", "health", "samples"}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With log and health, which a simulated recording lacks."""
    source, path = Recording(SICK), tmp_path_factory.mktemp("recording") / "sick.mcap"
    with RecordingWriter(path, source.metadata, source.attachments) as writer:
        for topic, record in source.messages():
            writer.write(topic, record)
        for number in range(3):
            health = {"imu": {"state": "ok", "bad": number, "words": ["a", {"b": 1.5}]}, "live": None, "what": ""}
            writer.write(topics.HEALTH, Health(10**9 * number, json.dumps(health)))
        writer.write(topics.LOG, LogLine(1_500_000_000, 30, "daemon", 'a "quoted", long\nline; 推移'))
    return path


@pytest.fixture(scope="module")
def folder(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    assert main(["review", str(recording), "--csv", str(folder), "--parquet", str(folder / "p")]) == 0
    assert {path.stem for path in folder.glob("*.csv")} == TABLES
    assert {path.name for path in (folder / "p").iterdir()} == {f"{name}.parquet" for name in TABLES}
    return folder


def rows_of(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def parquet_of(folder: Path, name: str) -> list[dict[str, Any]]:
    from pyarrow import parquet

    rows: list[dict[str, Any]] = parquet.read_table(folder / "p" / f"{name}.parquet").to_pylist()
    return rows


def decoded(path: Path, *names: str) -> list[tuple[str, int, Any]]:
    """Messages by the official library."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, message.log_time, found)
            for _, channel, message, found in reader.iter_decoded_messages(topics=list(names), log_time_order=False)
        ]


def test_steps_are_the_recorded_estimates(recording: Path, folder: Path) -> None:
    settled = decoded(recording, "/estimate/settled")
    rows, columns = rows_of(folder, "steps"), parquet_of(folder, "steps")
    assert len(rows) == len(columns) == len(settled) > 300
    for row, column, (_, t_ns, estimate) in zip(rows, columns, settled, strict=True):
        assert row["t_s"] == f"{t_ns / 1e9:.9f}"
        assert round(column["t_s"] * 1e9) == t_ns
        for name, field in (("displacement_mm", "displacement"), ("sigma_mm", "sigma"), ("velocity_mm_s", "velocity")):
            assert column[name] == getattr(estimate, field) * 1e3
            assert float(row[name]) == pytest.approx(column[name], abs=1e-6)
        assert float(row["smoothed_sigma_mm"]) <= float(row["sigma_mm"]) + 1e-6
    assert {row["segment"] for row in rows} == {"ZUPT", "VVS", "CVS"}


def test_displacement_events_log_and_health_are_as_recorded(recording: Path, folder: Path) -> None:
    readings = [record.reading for _, record in Recording(recording).messages((topics.OBSERVED, topics.REFERENCE))]  # type: ignore[union-attr]  # the topics hold nothing else
    rows, columns = rows_of(folder, "displacement"), parquet_of(folder, "displacement")
    assert len(rows) == len(columns) == len(readings)
    for row, column, reading in zip(rows, columns, readings, strict=True):
        sensor = "reference" if reading.is_reference else "observed"
        assert (
            (row["sensor"], row["fault"]) == (column["sensor"], column["fault"]) == (sensor, reading.fault.name.lower())
        )
        assert column["value_mm"] == pytest.approx(reading.value_m * 1e3, nan_ok=True)
        assert row["value_mm"] == ("" if reading.value_m != reading.value_m else f"{reading.value_m * 1e3:.6f}")
    assert {row["fault"] for row in rows} > {"none"}
    events = [(f"{t_ns / 1e9:.9f}", event.what) for _, t_ns, event in decoded(recording, "/events")]
    assert [(row["t_s"], row["what"]) for row in rows_of(folder, "events")] == events
    assert rows_of(folder, "log") == [
        {"t_s": "1.500000000", "level": "30", "logger": "daemon", "text": 'a "quoted", long\nline; 推移'}
    ]
    assert parquet_of(folder, "log")[0]["text"] == 'a "quoted", long\nline; 推移'
    health = [row for row in rows_of(folder, "health") if row["t_s"] == "2.000000000"]
    assert [(row["name"], row["number"], row["text"]) for row in health] == [
        ("imu.state", "", "ok"),
        ("imu.bad", "2.0", ""),
        ("imu.words.0", "", "a"),
        ("imu.words.1.b", "1.5", ""),
    ]


def test_samples_are_in_si_units_and_can_be_imported_again(
    recording: Path, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = [(t_ns, burst) for _, t_ns, burst in decoded(recording, "/imu/adis16448") if burst.fault == 0]
    columns = parquet_of(folder, "samples")
    assert len(columns) == len(good)
    settings = json.loads(Recording(recording).metadata["settings"])
    scale = {1000: 0.04, 500: 0.02, 250: 0.01}[settings["imu"]["gyro_range_dps"]] * 3.141592653589793 / 180
    for column, (t_ns, burst) in zip(columns[::50], good[::50], strict=True):
        assert round(column["t_s"] * 1e9) == t_ns
        assert column["gyro_x_rad_s"] == pytest.approx(burst.x_gyro * scale, rel=1e-9)
        assert column["accel_z_m_s2"] == pytest.approx(burst.z_accl / 1200 * 9.80665, rel=1e-9)
    again = tmp_path / "again.mcap"
    assert main(["import", str(folder / "samples.csv"), "-o", str(again)]) == 0
    capsys.readouterr()
    imported = [message for _, _, message in decoded(again, "/imu/sample")]
    assert len(imported) == len(columns)


def test_moves_are_those_of_the_summary(recording: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["review", str(recording), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["moves"]
    rows, columns = rows_of(folder, "moves"), parquet_of(folder, "moves")
    assert len(rows) == len(columns) == len(told) > 0
    for row, column, move in zip(rows, columns, told, strict=True):
        for name in ("onset_s", "stop_s", "start_mm", "end_mm", "sigma_mm", "velocity_mm_s"):
            assert float(row[name]) == column[name] == move[name]
        assert (row["kind"], column["can_state"]) == (move["kind"], move["can_state"])
        assert column["smoothed_end_mm"] == move["smoothed"]["end_mm"]


def test_several_recordings_have_a_folder_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = tmp_path / "other" / PARTIAL.name
    copy.parent.mkdir()
    copy.write_bytes(PARTIAL.read_bytes())
    assert main(["review", str(PARTIAL), str(copy), "--csv", str(tmp_path / "t"), "--json"]) == 0
    capsys.readouterr()
    assert {path.name for path in (tmp_path / "t").iterdir()} == {PARTIAL.stem, f"{PARTIAL.stem}-2"}
    one, two = (tmp_path / "t" / name / "steps.csv" for name in (PARTIAL.stem, f"{PARTIAL.stem}-2"))
    assert one.read_bytes() == two.read_bytes()


def interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def full(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("option", "place", "name"),
    [("--csv", Stream, "finish"), ("--parquet", Stream, "finish"), ("--png", pictures, "_fill")],
)
@pytest.mark.parametrize(("stub", "code"), [(interrupt, 130), (full, 1)])
def test_interrupted_or_failing_nothing_is_left(
    option: str, place: object, name: str, stub: object, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(place, name, stub)
    assert main(["review", str(PARTIAL), option, str(tmp_path / "a" / "b")]) == code
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_up_is_told_and_an_older_table_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "steps.csv").write_text("older")
    monkeypatch.setattr(CsvWriter, "add", full)
    assert main(["review", str(PARTIAL), "--csv", str(tmp_path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "cannot write" in line
    assert [path.name for path in tmp_path.iterdir()] == ["steps.csv"]
    assert (tmp_path / "steps.csv").read_text() == "older"


@pytest.mark.parametrize("option", ["--csv", "--parquet", "--png"])
def test_a_folder_that_cannot_be_is_refused_before_the_work(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Stream, "finish", lambda _: pytest.fail("the work was done"))
    own = tmp_path / "own.mcap"
    own.write_bytes(PARTIAL.read_bytes())
    assert main(["review", str(own), option, str(own)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{option} {own}: File exists; name a folder that can be written" in line
    assert own.read_bytes() == PARTIAL.read_bytes()


def test_without_pyarrow_one_sentence_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    assert main(["review", str(PARTIAL), "--parquet", str(tmp_path / "p")]) == 1
    assert capsys.readouterr().err == f"ramstroke: {needs('--parquet', 'pyarrow', 'parquet')}\n"


def test_pictures_of_the_whole_and_of_each_move_as_png_and_pdf(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for folder in ("one", "two"):
        assert main(["review", str(PARTIAL), "--png", str(tmp_path / folder)]) == 0
    capsys.readouterr()
    names = ["overview", "move-001-push", "move-002-push", "move-003-retract"]
    assert {path.name for path in (tmp_path / "one").iterdir()} == {
        f"{n}.{end}" for n in names for end in ("png", "pdf")
    }
    for path in (tmp_path / "one").iterdir():
        data = path.read_bytes()
        assert data == (tmp_path / "two" / path.name).read_bytes()
        if path.suffix == ".pdf":
            assert data.startswith(b"%PDF-")
            assert b"/Subtype /Image" not in data
        else:
            assert data.startswith(b"\x89PNG")
            at = data.index(b"pHYs") + 4
            assert round(struct.unpack(">I", data[at : at + 4])[0] * 0.0254) == 200
