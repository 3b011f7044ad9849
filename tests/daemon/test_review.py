"""`ramstroke review`: what a recording holds, in words and as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from daemon.cli import main

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
