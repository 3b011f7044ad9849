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
from estimation.settings import MountSettings
from tests.estimation.support import SHORT, Run, run_of

REGRESSION = Path(__file__).parent.parent / "data" / "regression"
SILENT = REGRESSION / "controller_falls_silent_in_a_push.mcap"


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
        "against the reference",
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
