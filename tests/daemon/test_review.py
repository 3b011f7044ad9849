"""`ramstroke review`: what a recording holds, in words and as JSON."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.cli import main
from daemon.configuration import load
from daemon.offline.replaying.replay import replay
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import RecordedDisplacement
from estimation.settings import MountSettings
from tests.estimation.support import SHORT, Run, run_of

REGRESSION = Path(__file__).parent.parent / "data" / "regression"
SILENT = REGRESSION / "controller_falls_silent_in_a_push.mcap"
PARTIAL = REGRESSION / "partial_push_and_retract.mcap"


def reviewed(capsys: pytest.CaptureFixture[str], path: Path, *options: str) -> dict[str, Any]:
    """Run the command with --json."""
    assert main(["review", str(path), "--json", *options]) == 0
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    return told


def table_of(path: Path) -> dict[str, list[str]]:
    with path.open(newline="") as stream:
        rows = list(csv.reader(stream))
    return {name: list(column) for name, column in zip(rows[0], zip(*rows[1:], strict=True), strict=True)}


def test_review_tells_contents_sensor_health_and_moves(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["review", str(SILENT), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["complete"] is True
    assert told["samples"] == told["messages"]["/imu/adis16448"]
    assert told["identical"] is True
    assert [move["kind"] for move in told["moves"]] == ["push", "retract"]
    assert told["moves"][0]["can_state"] == "silent"
    # The controller is silent from second 8.5 to the end; the laboratory sensor goes on, fifty times a second.
    assert told["can_states"]["silent"] == pytest.approx(1 - 9.5 / told["duration_s"], abs=0.05)
    assert told["reference"]["readings"] == pytest.approx(50 * told["duration_s"], rel=0.02)


def test_review_in_words_names_every_part(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["review", str(SILENT)]) == 0
    words = capsys.readouterr().out
    for part in (
        "recording, complete",
        "good samples",
        "/can/rx",
        "silent",
        "start proposed (push)",
        "push",
        "push at 6.00 s, smoothed: 0.0 ± 0.5 to ",
        "mm from settled at most",
        "against the reference",
        "smoothed, against the same",
    ):
        assert part in words


def test_review_of_a_cut_file_says_so_and_of_a_missing_one_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(SILENT.read_bytes()[:300_000])
    assert main(["review", str(cut)]) == 0
    assert "cut short or still being written" in capsys.readouterr().out
    assert main(["review", str(tmp_path / "none.mcap")]) == 1
    assert "does not exist" in capsys.readouterr().err


def test_the_table_has_settled_and_smoothed_values_side_by_side_and_the_figures_follow_from_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settled = tmp_path / "settled.csv"
    told = reviewed(capsys, PARTIAL, "--csv", str(tmp_path / "both"))
    assert main(["replay", str(PARTIAL), "--csv", str(settled)]) == 0
    columns, plain = table_of(tmp_path / "both" / "steps.csv"), table_of(settled)
    assert {name: columns[name] for name in plain} == plain
    t_s, p, sigma, smoothed, smoothed_sigma = (
        np.array(columns[name], dtype=float)
        for name in ("t_s", "displacement_mm", "sigma_mm", "smoothed_displacement_mm", "smoothed_sigma_mm")
    )
    assert np.all(smoothed_sigma <= sigma + 1e-6)
    assert (p[-1], sigma[-1]) == (smoothed[-1], smoothed_sigma[-1])

    assert [move["kind"] for move in told["moves"]] == ["push", "push", "retract"]
    moving = np.array([segment != "ZUPT" for segment in columns["segment"]])
    for move in told["moves"]:
        of_move = np.flatnonzero(moving & (t_s > move["onset_s"] - 1) & (t_s < move["stop_s"] + 1))
        first, last = of_move[0], of_move[-1] + 1
        row = move["smoothed"]
        assert (row["start_mm"], row["start_sigma_mm"]) == pytest.approx((smoothed[first], smoothed_sigma[first]))
        assert (row["end_mm"], row["end_sigma_mm"]) == pytest.approx((smoothed[last], smoothed_sigma[last]))
        difference = (smoothed - p)[first : last + 1]
        assert row["largest_difference_mm"] == pytest.approx(difference[np.argmax(np.abs(difference))], abs=1e-5)
        assert row["velocity_mm_s"] == pytest.approx(move["velocity_mm_s"], rel=0.03)
        assert 0 < row["velocity_sigma_mm_s"] < 0.02 * abs(row["velocity_mm_s"])
        # The stop that the second push reached tells where the first one had ended.
        assert row["end_sigma_mm"] <= move["sigma_mm"]
    assert told["moves"][0]["smoothed"]["end_sigma_mm"] < 0.6 * told["moves"][0]["sigma_mm"]
    assert told["moves"][1]["smoothed"]["start_mm"] == pytest.approx(told["moves"][0]["smoothed"]["end_mm"], abs=0.1)


@pytest.mark.parametrize(
    ("field", "column"), [("reference", "displacement_mm"), ("reference_smoothed", "smoothed_displacement_mm")]
)
def test_errors_against_the_reference_are_those_of_the_table(
    field: str, column: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = reviewed(capsys, PARTIAL, "--csv", str(tmp_path))
    columns = {
        name: np.array(column, dtype=float)
        for name, column in table_of(tmp_path / "steps.csv").items()
        if name.endswith(("_s", "_mm"))
    }
    readings = [
        record.reading
        for _, record in Recording(PARTIAL).messages((topics.REFERENCE,))
        if isinstance(record, RecordedDisplacement) and record.reading.valid
    ]
    t_s = np.array([reading.t_ns for reading in readings]) * 1e-9
    within = (t_s > columns["t_s"][0]) & (t_s <= columns["t_s"][-1])
    reference_mm = np.array([reading.value_m for reading in readings])[within] * 1e3
    errors = np.interp(t_s[within], columns["t_s"], columns[column]) - reference_mm
    after = np.searchsorted(columns["t_s"], t_s[within])
    sigma = columns[column.replace("displacement", "sigma") if "smoothed" in column else "sigma_mm"]
    inside = np.abs(errors) <= 1.96 * np.maximum(sigma[after - 1], sigma[after])
    assert told[field]["readings"] == len(errors)
    assert told[field]["mean_mm"] == pytest.approx(errors.mean(), abs=1e-4)
    assert told[field]["rms_mm"] == pytest.approx(np.sqrt(np.mean(errors**2)), abs=1e-4)
    assert told[field]["worst_mm"] == pytest.approx(errors[np.argmax(np.abs(errors))], abs=1e-4)
    assert told[field]["inside_95"] == pytest.approx(inside.mean(), abs=2 / len(errors))


def test_smoothing_comes_nearer_to_the_reference(capsys: pytest.CaptureFixture[str]) -> None:
    told = reviewed(capsys, PARTIAL)
    assert told["reference_smoothed"]["rms_mm"] < 0.6 * told["reference"]["rms_mm"]
    assert told["reference_smoothed"]["inside_95"] > 0.8


def test_without_moves_and_reference_there_is_nothing_smoothed_to_tell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, imported = tmp_path / "rest.csv", tmp_path / "rest.mcap"
    header = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
    rows = [f"{number / 200:.3f},0.001,-0.002,0,{number % 3 * 0.01},0,9.81" for number in range(1000)]
    table.write_text("\n".join([header, *rows]) + "\n")
    assert main(["import", str(table), "-o", str(imported)]) == 0
    capsys.readouterr()
    told = reviewed(capsys, imported, "--csv", str(tmp_path))
    assert (told["moves"], told["reference"], told["reference_smoothed"]) == ([], None, None)
    columns = table_of(tmp_path / "steps.csv")
    assert len(columns["t_s"]) == 1000 // 8
    assert set(columns["smoothed_velocity_mm_s"]) == {"0.000000"}
    assert main(["review", str(imported)]) == 0
    said = capsys.readouterr().out
    assert "no reference sensor in it" in said
    assert "smoothed" not in said


def test_smoothing_leaves_the_replay_as_it_is() -> None:
    assert replay(SILENT, smoothed=lambda _: None).identical is True


def mount_of(path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert main(["review", str(path), "--estimate-mount", "--json"]) == 0
    mount: dict[str, Any] = json.loads(capsys.readouterr().out)["mount"]
    return mount


def test_mount_is_estimated_when_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["review", str(SILENT), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mount"] is None
    told = mount_of(SILENT, capsys)
    assert (told["verdict"], told["push_axis"], told["up_axis"], told["agrees"]) == ("determined", "+y", "+z", True)
    # The virtual support's mounting error: 3 degrees about each axis.
    for name in ("push", "up"):
        assert math.hypot(*told[name]) == pytest.approx(1.0)
        assert 0 < told[f"{name}_sigma_deg"] < 3
        assert told[f"{name}_off_deg"] < 6 + 3 * told[f"{name}_sigma_deg"]
    assert told["off_deg"] == max(told["push_off_deg"], told["up_off_deg"])
    assert told["bursts"] == 4
    assert main(["review", str(SILENT), "--estimate-mount"]) == 0
    assert "# as configured" in capsys.readouterr().out.splitlines()


def test_undetermined_mount_has_nulls_and_says_what_is_needed(capsys: pytest.CaptureFixture[str]) -> None:
    told = mount_of(REGRESSION / "wet_cable_in_a_push.mcap", capsys)
    assert told["verdict"] == "undetermined"
    assert "at least two moves" in told["why"]
    assert told["up_axis"] == "+z"
    assert [told[key] for key in ("push", "push_axis", "off_deg", "chi_square", "agrees")] == [None] * 5


def test_a_wrong_mount_is_named_and_the_right_lines_can_be_pasted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mount = MountSettings(push="-z", up="+x")
    write_table(run_of(4, script=SHORT, mount=mount), tmp_path / "table.csv")
    recording = tmp_path / "turned.mcap"
    assert main(["import", str(tmp_path / "table.csv"), "-o", str(recording)]) == 0
    capsys.readouterr()
    assert main(["review", str(recording), "--estimate-mount"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert '# NOT as configured: the recording was made with push = "+y", up = "+z"' in lines
    begin = lines.index("[mount]")
    pasted = tmp_path / "pasted.toml"
    pasted.write_text("\n".join(lines[begin:]) + "\n")
    assert load(pasted).mount == mount
    assert mount_of(recording, capsys)["agrees"] is False


def write_table(run: Run, path: Path) -> None:
    """As `ramstroke import` takes it; a reading of the displacement sensor follows the sample before it."""
    readings = {int(np.searchsorted(run.t_ns, reading.t_ns)) - 1: reading.value_m for reading in run.readings}
    with path.open("w", newline="") as stream:
        rows = csv.writer(stream)
        axes = [f"{name}_{axis}_{unit}" for name, unit in (("gyro", "rad_s"), ("accel", "m_s2")) for axis in "xyz"]
        rows.writerow(["t_s", *axes, "observed_mm"])
        for i, (t_ns, gyro, accel) in enumerate(
            zip(run.t_ns.tolist(), run.gyro.tolist(), run.accel.tolist(), strict=True)
        ):
            observed = f"{readings[i] * 1e3:.0f}" if i in readings else ""
            rows.writerow([f"{t_ns * 1e-9:.9f}", *gyro, *accel, observed])
