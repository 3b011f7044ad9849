"""A table becomes a recording with the very numbers of the table, and what was left out is told."""

from __future__ import annotations

import csv
import gzip
import math
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.offline import importer
from daemon.offline.importer import CsvError, import_csv
from daemon.recording import topics
from daemon.recording.errors import RecordingError
from daemon.recording.reader import Recording
from daemon.recording.topics import Recorded, RecordedDisplacement
from estimation.records import Displacement, ImuSample, TimeKind

HEADER = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
MOTION = ",0.1,-0.2,0.3,9.81,1e-3,-0.0"


def write_table(folder: Path, *lines: str, header: str = HEADER) -> Path:
    path = folder / "table.csv"
    path.write_text("\n".join((header, *lines)) + "\n", encoding="utf-8")
    return path


def messages_of(path: Path) -> list[tuple[str, Recorded]]:
    recording = Recording(path)
    messages = list(recording.messages())
    assert (recording.complete, recording.damage) == (True, [])
    return messages


def test_values_times_and_displacements_arrive_as_given_each_displacement_behind_its_sample(
    tmp_path: Path,
) -> None:
    header = HEADER + ",reference_mm,temperature_c,observed_mm,comment"
    source = write_table(
        tmp_path,
        f"0{MOTION},,,,",
        f"0.001220703{MOTION},250.125,21.5,249.5,hello",
        f" 1e1 {MOTION},nan, ,100,",
        header=header,
    )
    out = tmp_path / "out.mcap"
    report = import_csv(source, out, '{"stroke": 500}', sensor="xsens")

    def sample(t_ns: int, temperature_c: float) -> tuple[str, ImuSample]:
        motion = (0.1, -0.2, 0.3), (9.81, 0.001, -0.0)
        return topics.IMU_SAMPLE, ImuSample(t_ns, *motion, temperature_c, TimeKind.IMPORTED)

    def displacement(t_ns: int, value_m: float, is_reference: bool) -> tuple[str, RecordedDisplacement]:
        topic = topics.REFERENCE if is_reference else topics.OBSERVED
        reading = Displacement(t_ns, value_m, is_reference=is_reference)
        return topic, RecordedDisplacement(reading, decoded=False)

    found = messages_of(out)
    assert repr(found) == repr(  # by text, because NaN differs from itself
        [
            sample(0, math.nan),
            sample(1_220_703, 21.5),
            displacement(1_220_703, 0.2495, False),
            displacement(1_220_703, 0.250125, True),
            sample(10_000_000_000, math.nan),
            displacement(10_000_000_000, 0.1, False),
        ]
    )
    assert (report.rows, report.dropped, report.dropped_values, report.ignored) == (3, {}, {}, ["comment"])
    assert (report.duration_s, report.rate_hz) == (10.0, 0.2)
    metadata = Recording(out).metadata
    assert (metadata["kind"], metadata["settings"], metadata["sensor"]) == (
        "import",
        '{"stroke": 500}',
        "xsens",
    )


@settings(derandomize=True, deadline=None, max_examples=50)
@given(
    st.lists(
        st.tuples(st.decimals(0, 9_000_000_000, places=9), *[st.floats(allow_nan=False, allow_infinity=False)] * 6),
        min_size=1,
        max_size=20,
        unique_by=lambda row: row[0],
    )
)
def test_numbers_are_those_of_the_text_and_times_exact_to_the_nanosecond(
    tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[object, ...]]
) -> None:
    folder = tmp_path_factory.getbasetemp()
    rows.sort()
    lines = [",".join(map(str, row)) for row in rows]
    import_csv(write_table(folder, *lines), folder / "exact.mcap", "{}")
    samples = [record for _, record in messages_of(folder / "exact.mcap")]
    assert len(samples) == len(rows)
    for sample, (t_s, *motion) in zip(samples, rows, strict=True):
        assert isinstance(sample, ImuSample)
        assert sample.t_ns == Fraction(str(t_s)) * 10**9
        assert [*sample.gyro, *sample.accel] == motion


def test_a_compressed_table_with_other_column_order_quotes_and_byte_order_mark_is_read(
    tmp_path: Path,
) -> None:
    source = tmp_path / "table.csv.gz"
    names = HEADER.split(",")[::-1]
    with gzip.open(source, "wt", encoding="utf-8-sig", newline="") as stream:
        writer = csv.writer(stream, quoting=csv.QUOTE_ALL)
        writer.writerow(names)
        writer.writerow([6, 5, 4, 3, 2, 1, 0.5])
        stream.write("\r\n")
    report = import_csv(source, tmp_path / "out.mcap", "{}")
    ((_, sample),) = messages_of(tmp_path / "out.mcap")
    assert isinstance(sample, ImuSample)
    assert (sample.t_ns, sample.gyro, sample.accel) == (500_000_000, (1, 2, 3), (4, 5, 6))
    assert (report.rows, report.duration_s) == (1, 0)
    assert math.isnan(report.rate_hz)


def test_unusable_rows_are_left_out_and_counted_by_reason(tmp_path: Path) -> None:
    source = write_table(
        tmp_path,
        f"1{MOTION}",
        f"1{MOTION}",
        f"0.5{MOTION}",
        ",1,2,3,4,5,6",
        "2,1,2,x,4,5,6",
        "2,1,2,,4,5,6",
        "nan,1,2,3,4,5,6",
        "2,1,2,3,4,5,inf",
        "2,1,2,3,4,5,nan",
        "2,1,2,3,4,5",
        "2,1,2,3,4,5,6,7",
        f"3{MOTION}",
    )
    report = import_csv(source, tmp_path / "out.mcap", "{}")
    assert report.rows == 2
    assert report.dropped == {
        "time does not increase": 2,
        "a required value is missing or not a number": 4,
        "a required value is not finite": 2,
        "as many values as columns are needed": 2,
    }
    times = [record.t_ns for _, record in messages_of(tmp_path / "out.mcap") if isinstance(record, ImuSample)]
    assert times == [1_000_000_000, 3_000_000_000]


def test_unusable_optional_values_are_counted_and_the_row_is_kept(tmp_path: Path) -> None:
    source = write_table(
        tmp_path,
        f"1{MOTION},warm,n/a",
        f"2{MOTION},20,inf",
        f"3{MOTION},20,7",
        header=HEADER + ",temperature_c,observed_mm",
    )
    report = import_csv(source, tmp_path / "out.mcap", "{}")
    assert (report.rows, report.dropped) == (3, {})
    assert report.dropped_values == {"temperature_c": 1, "observed_mm": 2}
    assert [topic for topic, _ in messages_of(tmp_path / "out.mcap")] == [topics.IMU_SAMPLE] * 3 + [topics.OBSERVED]


def test_progress_is_told_and_the_table_is_not_held_in_memory(tmp_path: Path) -> None:
    rows = [f"{number}{MOTION}" for number in range(40_500)]
    for name in ("table.csv", "table.csv.gz"):
        source = write_table(tmp_path, *rows)
        if name.endswith(".gz"):
            packed = tmp_path / name
            packed.write_bytes(gzip.compress(source.read_bytes()))
            source = packed
        told: list[float] = []
        assert import_csv(source, tmp_path / "out.mcap", "{}", progress=told.append).rows == 40_500
        assert told == pytest.approx([0.25, 0.5, 0.75, 1.0], abs=0.1)


BROKEN: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "is empty: a table with a header row is needed"),
    "no header": (b"0,1,2,3,4,5,6\n", "lacks the columns t_s, gyro_x_rad_s, .*, accel_z_m_s2"),
    "one column missing": (HEADER.replace(",gyro_y_rad_s", "").encode(), "lacks the column gyro_y_rad_s: "),
    "column twice": (HEADER.encode() + b",t_s\n", "has the column t_s more than once"),
    "only a header": (HEADER.encode() + b"\n", "no usable row: there is nothing below its header"),
    "nothing usable": (
        HEADER.encode() + b"\nx,1,2,3,4,5,6\n",
        r"no usable row: a required value is missing or not a number \(1 rows\)",
    ),
    "negative time": (f"{HEADER}\n-0.5{MOTION}\n".encode(), r"row 2: t_s = -0\.5 must be between 0 and"),
    "absurd time": (f"{HEADER}\n1e999999{MOTION}\n".encode(), r"row 2: t_s = 1e999999 must be between 0 and"),
    "not text": (b"\xff\xfe\x00\x01" * 50, "is not text in UTF-8"),
    "open quote": (f'{HEADER}\n"1{MOTION}\n'.encode(), "is not a proper CSV table"),
    "huge quoted field": (HEADER.encode() + b'\n"' + b"1\n" * 100_000, "is not a proper CSV table"),
    "endless line": (HEADER.encode() + b"\n" + b"1" * 1_000_000, "line of more than 65536 characters"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_table_that_cannot_be_used_is_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    content, words = BROKEN[name]
    source = tmp_path / "table.csv"
    source.write_bytes(content)
    with pytest.raises(CsvError, match=words) as caught:
        import_csv(source, tmp_path / "out.mcap", "{}")
    assert str(caught.value).startswith(str(source))
    assert list(tmp_path.iterdir()) == [source], "nothing half-written stays"


def test_a_damaged_archive_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "table.csv.gz"
    whole = gzip.compress(f"{HEADER}\n0{MOTION}\n".encode())
    for content in (b"plain", whole[:-10], whole[:10] + b"\xff" * 20, whole[:-8] + bytes(8)):
        source.write_bytes(content)
        with pytest.raises(CsvError, match="is damaged or not compressed by gzip"):
            import_csv(source, tmp_path / "out.mcap", "{}")
    assert list(tmp_path.iterdir()) == [source]


def test_a_missing_table_and_a_table_as_its_own_target_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"cannot read .*none\.csv: No such file"):
        import_csv(tmp_path / "none.csv", tmp_path / "out.mcap", "{}")
    source = write_table(tmp_path, f"0{MOTION}")
    with pytest.raises(RecordingError, match="name another file"):
        import_csv(source, source, "{}")
    assert source.read_text().startswith("t_s")


def test_a_long_line_is_found_before_it_is_read_whole(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(importer, "_LONGEST_LINE", 200)
    assert import_csv(write_table(tmp_path, f"0{MOTION}"), tmp_path / "out.mcap", "{}").rows == 1
    with pytest.raises(CsvError, match="more than 200 characters"):
        import_csv(write_table(tmp_path, f"0{MOTION}" + " " * 200), tmp_path / "out.mcap", "{}")
