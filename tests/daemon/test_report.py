"""`ramstroke review -o`: what the page holds, its escaping, its errors."""

from __future__ import annotations

import errno
import json
import re
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from daemon.cli import main
from daemon.offline.report import document
from daemon.recording import topics
from daemon.recording.metadata import METADATA_NAME
from daemon.recording.reader import Recording
from daemon.recording.topics import Health, LogLine
from daemon.recording.writer import RecordingWriter
from daemon.stream import Stream
from tests.daemon.recording_kit import METADATA
from tests.daemon.report_kit import ReportPage, array_of

REGRESSION = Path(__file__).parent.parent / "data" / "regression"
PARTIAL = REGRESSION / "partial_push_and_retract.mcap"
SILENT = REGRESSION / "controller_falls_silent_in_a_push.mcap"
SICK = REGRESSION / "another_sensor_and_a_sick_bus.mcap"
NASTY = '</script><script>alert(1)</script><img src=x onerror="alert(2)"> & \u2028 "quoted"'


def page_of(tmp_path: Path, *arguments: object) -> ReportPage:
    report = tmp_path / "report.html"
    assert main(["review", *map(str, arguments), "-o", str(report)]) == 0
    assert [path for path in tmp_path.iterdir() if path.name.startswith(".")] == []
    return ReportPage(report)


def settled_of(path: Path) -> dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """The recorded settled estimates, by the official library."""
    fields = ("displacement", "sigma", "velocity", "velocity_sigma", "acceleration", "chart_lower", "chart_upper")
    rows: list[list[float]] = []
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, _, message, decoded in reader.iter_decoded_messages(topics=["/estimate/settled"], log_time_order=False):
            rows.append([message.log_time, *(getattr(decoded, name) for name in fields)])
    columns = np.array(rows).T
    return dict(zip(("t_ns", *fields), columns, strict=True))


def test_embedded_steps_are_those_of_the_recording(tmp_path: Path) -> None:
    numbers = page_of(tmp_path, PARTIAL).numbers[0]
    settled = settled_of(PARTIAL)
    t_s = array_of(numbers["fine"], "<u4") * numbers["tick"]
    begin_ns = min(
        message.log_time
        for _, _, message in make_reader(PARTIAL.open("rb")).iter_messages(topics=["/imu/adis16448", "/can/rx"])
    )
    assert len(t_s) == len(settled["t_ns"]) > 500
    assert t_s == pytest.approx((settled["t_ns"] - begin_ns) * 1e-9, abs=1e-6)
    for name, field, factor in (
        ("stroke", "displacement", 1e3),
        ("velocity", "velocity", 1e3),
        ("acceleration", "acceleration", 1.0),
    ):
        fine = array_of(numbers["signals"][name]["fine"])
        assert np.array_equal(fine, (settled[field] * factor).astype(np.float32))
    for name, centre, half in (
        ("stroke", "displacement", "sigma"),
        ("velocity", "velocity", "velocity_sigma"),
    ):
        packed = numbers["signals"][name]
        assert array_of(packed["half_fine"]) == pytest.approx(1.96e3 * settled[half], rel=1e-6)
        low, high, width = (array_of(packed[end]) for end in ("low", "high", "half"))
        cell = ((settled["t_ns"] - begin_ns) / 1e9 / numbers["grid"]["cell"]).astype(int)
        assert np.all(low[cell] - width[cell] <= 1e3 * (settled[centre] - 1.96 * settled[half]) + 1e-3)
        assert np.all(high[cell] + width[cell] >= 1e3 * (settled[centre] + 1.96 * settled[half]) - 1e-3)


def test_readings_are_told_apart_by_what_is_wrong_with_them(tmp_path: Path) -> None:
    page = page_of(tmp_path, SICK)
    numbers = page.numbers[0]
    packed = numbers["readings"]["observed"]
    readings = [record.reading for _, record in Recording(SICK).messages((topics.OBSERVED,))]  # type: ignore[union-attr]  # the topic holds nothing else
    assert packed["count"] == len(readings)
    values, words = array_of(packed["fine_values"]), array_of(packed["fine_words"], "u1")
    assert values == pytest.approx([reading.value_m * 1e3 for reading in readings], rel=1e-6, nan_ok=True)
    told = [numbers["words"][word] for word in words]
    for reading, word in zip(readings, told, strict=True):
        if not reading.valid:
            assert word == reading.fault.name.lower().replace("_", " ")
    assert packed["ill_count"] == sum(word != "good" for word in told) > 0
    errors = sum(frame.is_error for _, frame in Recording(SICK).messages((topics.CAN_RX,)))  # type: ignore[union-attr]
    assert int(array_of(numbers["rates"]["errors"], "<u4").sum()) == errors
    assert f"{errors} CAN error frame" in page.text


def test_moves_and_their_verdicts_are_those_of_the_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = page_of(tmp_path, PARTIAL, "--methods", "kf2,clock", "--json")
    told = json.loads(capsys.readouterr().out)
    rows = page.table("Moves")
    assert "2 pushes, 1 retract" in page.text
    assert [row["move"] for row in rows] == ["push 1", "push 2", "retract 3"]
    for row, move in zip(rows, told["moves"], strict=True):
        assert row["onset"] == f"{move['onset_s']:.2f} s"
        assert float(row["end mm"]) == pytest.approx(move["end_mm"], abs=0.051)
        assert float(row["± 1σ"]) == pytest.approx(move["sigma_mm"], abs=0.051)
        assert float(row["smoothed end mm"]) == pytest.approx(move["smoothed"]["end_mm"], abs=0.051)
        assert float(row["before stop mm"]) == pytest.approx(move["end_before_stop_mm"], abs=0.051)
        assert float(row["reference mm"]) == pytest.approx(move["end_mm"], abs=3.0)
    settled = [message for message in _innovations(PARTIAL) if message[1] == message[1]]
    for row, move in zip(rows, told["moves"], strict=True):
        inside = [mm for t_s, mm in settled if move["onset_s"] <= t_s < move["stop_s"] + 1.5]
        assert float(row["largest innovation mm"]) == pytest.approx(max(inside, key=abs), abs=0.051)
    assert main(["review", str(PARTIAL), "--method", "kf2", "--json"]) == 0
    kf2 = json.loads(capsys.readouterr().out)["moves"]
    assert [float(row["kf2 mm"]) for row in rows] == pytest.approx([move["end_mm"] for move in kf2], abs=0.051)
    assert set(page.numbers[0]["others"]) == {"kf2", "clock"}


def _innovations(path: Path) -> list[tuple[float, float]]:
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [
            (message.log_time * 1e-9, decoded.innovation * 1e3)
            for _, _, message, decoded in reader.iter_decoded_messages(topics=["/estimate/settled"])
        ]


def test_the_page_asks_nobody_for_anything(tmp_path: Path) -> None:
    page = page_of(tmp_path, PARTIAL)
    for name, attributes in page.elements:
        assert name not in ("link", "iframe", "img", "object", "base"), name
        assert "src" not in attributes
    policy = next(a["content"] for n, a in page.elements if n == "meta" and "content-security-policy" in str(a).lower())
    assert policy is not None
    assert "default-src 'none'" in policy
    assert "http" not in policy


def with_lines(source: Path, target: Path, text: str) -> Path:
    """A copy of a recording with a log line, an event's name and a health record that say `text`."""
    recording = Recording(source)
    metadata = dict(recording.metadata) | {"sensor": text}
    with RecordingWriter(target, metadata, recording.attachments) as writer:
        for topic, record in recording.messages():
            writer.write(topic, record)
        part = {"state": text, "what": text}
        writer.write(topics.HEALTH, Health(5_000_000_000, json.dumps({"imu": part})))
        writer.write(topics.LOG, LogLine(5_000_000_000, 40, text, text))
        writer.write(topics.HEALTH, Health(6_000_000_000, "no JSON"))
    return target


def test_text_of_a_recording_never_becomes_markup(tmp_path: Path) -> None:
    clean = page_of(tmp_path, PARTIAL)
    recording = with_lines(PARTIAL, tmp_path / "<b>name &amp; all.mcap", NASTY)
    page = page_of(tmp_path, recording)
    scripts = [attributes for name, attributes in page.elements if name == "script"]
    assert len(scripts) == len([1 for name, _ in clean.elements if name == "script"])
    assert not any(name in ("img", "b") for name, _ in page.elements)
    assert not any(key.startswith("on") for _, attributes in page.elements for key in attributes)
    assert " ".join(NASTY.split()) in page.text
    assert "<b>name &amp; all.mcap" in page.text
    assert any(span[2:] == [NASTY, NASTY] for lane in page.numbers[0]["lanes"] for span in lane["spans"])


def test_several_recordings_stand_side_by_side_with_what_differs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = page_of(tmp_path, PARTIAL, SILENT, "--json")
    told = json.loads(capsys.readouterr().out)
    assert [row["file"] for row in told["files"]] == [str(PARTIAL), str(SILENT)]
    assert len(page.numbers) == 2
    assert [a["id"] for n, a in page.elements if a.get("role") == "tab"] == ["tab-0", "tab-1"]
    differing = {row["setting"]: row for row in page.table("Settings that differ between the files")}
    row = differing["can.channel"]
    assert (row[PARTIAL.name], row[SILENT.name]) == (PARTIAL.stem, SILENT.stem)
    assert "support.stroke_mm" not in differing


def test_settings_that_differ_from_the_defaults_come_first(tmp_path: Path) -> None:
    page = page_of(tmp_path, PARTIAL)
    changed = {row["setting"]: (row["value"], row["default"]) for row in page.table("Settings that differ from")}
    assert changed["support.stroke_mm"] == ("120.0", "500.0")
    assert "estimator.stop_sigma_mm" not in changed
    everything = {row["setting"]: row["value"] for row in page.table("All settings")}
    assert everything["estimator.stop_sigma_mm"] == "0.6"


def test_times_of_day_are_those_of_this_computers_zone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = Recording(PARTIAL)
    metadata = dict(recording.metadata) | {"wall_minus_monotonic_ns": str(1_767_591_000_000_000_000)}  # 05:30 UTC
    path = tmp_path / "day.mcap"
    with RecordingWriter(path, metadata, recording.attachments) as writer:
        for topic, record in recording.messages():
            writer.write(topic, record)
    import time

    monkeypatch.setenv("TZ", "CST-8")
    time.tzset()
    try:
        page = page_of(tmp_path, path)
    finally:
        monkeypatch.undo()
        time.tzset()
    onset = page.table("Moves")[0]["onset"]
    assert onset == "13:30:06.0"
    clock = page.numbers[0]["clock"]
    assert clock["zero"] == pytest.approx((1_767_591_000 + 8 * 3600) * 1e3, abs=100)
    assert "UTC+08:00" in clock["name"]


def test_a_cut_file_says_so_and_shows_what_is_there(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(PARTIAL.read_bytes()[: PARTIAL.stat().st_size // 2])
    page = page_of(tmp_path, cut)
    assert "the file was cut short or is still being written" in page.text
    whole = page_of(tmp_path, PARTIAL)
    shares = [array_of(p.numbers[0]["fine"], "<u4").size for p in (page, whole)]
    assert 0.2 < shares[0] / shares[1] < 0.8


def test_a_recording_without_a_message_or_without_a_move_makes_a_page_too(tmp_path: Path) -> None:
    settings = Recording(PARTIAL).metadata["settings"]
    empty = tmp_path / "empty.mcap"
    with RecordingWriter(empty, dict(METADATA) | {"settings": settings}):
        pass
    page = page_of(tmp_path, empty)
    assert "no moves" in page.text
    assert "no estimate" in page.text
    table = tmp_path / "rest.csv"
    header = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
    table.write_text(
        "\n".join([header, *(f"{i / 200:.3f},0.001,0,0,{i % 3 * 0.01},0,9.81" for i in range(1000))]) + "\n"
    )
    assert main(["import", str(table), "-o", str(tmp_path / "rest.mcap")]) == 0
    page = page_of(tmp_path, tmp_path / "rest.mcap")
    assert "no moves" in page.text
    assert "no displacement sensor" in page.text


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("none/report.html", "is no folder"),
        (".", "it is a folder"),
        ("own.mcap", "name another file for the result"),
        ("own.mcap/report.html", "is no folder"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    target: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "own.mcap"
    own.write_bytes(PARTIAL.read_bytes())
    monkeypatch.setattr(Stream, "finish", lambda _: pytest.fail("the work was done"))
    assert main(["review", str(own), "-o", str(tmp_path / target)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert own.read_bytes() == PARTIAL.read_bytes()
    assert list(tmp_path.iterdir()) == [own]


def test_bad_recordings_are_refused_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from mcap.writer import Writer

    foreign, nothing = tmp_path / "foreign.mcap", tmp_path / "nothing.mcap"
    with foreign.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="another program")
        schema = writer.register_schema("x", "jsonschema", b"{}")
        channel = writer.register_channel("/x", "json", schema)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    nothing.touch()
    for path, said in ((foreign, "another program"), (nothing, "nothing was recorded")):
        for names in ([path], [PARTIAL, path]):
            assert main(["review", *map(str, names), "-o", str(tmp_path / "report.html")]) == 1
            (line,) = capsys.readouterr().err.splitlines()
            assert said in line
            assert not (tmp_path / "report.html").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--methods", "kf2"], "name -o"),
        (["-o", "r.html", "--method", "kf2"], "--methods"),
        (["-o", "r.html", "--methods", "moon"], "--methods moon is unknown"),
        (["-o", "r.html", "--methods", "mskf"], "in the report anyway"),
        ([str(PARTIAL)], "named twice"),
        ([str(SILENT), "--allan", "--plot", "x.png"], "name one recording"),
    ],
)
def test_impossible_wishes_are_refused(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["review", str(PARTIAL), *arguments]) == 2
    assert said in capsys.readouterr().err


def test_interrupted_or_failing_no_half_page_is_left_and_an_older_one_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    report = tmp_path / "report.html"
    report.write_text("older")

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    for stub, code in ((interrupt, 130), (full, 1)):
        with monkeypatch.context() as patch:
            patch.setattr(document, "json_script", stub)
            assert main(["review", str(PARTIAL), "-o", str(report)]) == code
        assert report.read_text() == "older"
        assert list(tmp_path.iterdir()) == [report]
    assert f"cannot write {report}" in capsys.readouterr().err


def test_without_plotly_one_sentence_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "plotly.offline", None)
    assert main(["review", str(PARTIAL), "-o", str(tmp_path / "report.html")]) == 1
    assert "a report needs plotly: `systemd/install.sh --with offline WHEEL` as root" in capsys.readouterr().err


def test_the_page_grows_by_what_is_seen_not_by_what_was_recorded(tmp_path: Path) -> None:
    """Plots take at most a few bytes a step more than the library itself."""
    page = page_of(tmp_path, PARTIAL)
    numbers = re.search(r'<script type="application/json" id="numbers-0">(.*?)</script>', page.source)
    assert numbers is not None
    steps = array_of(page.numbers[0]["fine"], "<u4").size
    assert len(numbers.group(1)) < 140 * steps
    assert len(page.source) < len(document.require_plotly()) + len(numbers.group(1)) + 300_000
    assert METADATA_NAME in page.text
