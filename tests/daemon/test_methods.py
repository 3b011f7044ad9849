"""Other methods than ours through the commands: replay, review, evaluate."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from daemon.cli import main
from daemon.offline.evaluation.methods import OURS_INERTIAL, evaluate_methods, summarise_methods
from daemon.recording.reader import Recording
from daemon.recording.topics import MOVES, SETTLED
from estimation.methods.registry import METHODS

RECORDING = Path(__file__).parents[1] / "data" / "regression" / "partial_push_and_retract.mcap"


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, object]:
    assert main([*arguments, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert isinstance(answer, dict)
    return answer


def test_replay_by_the_clock_gives_nominal_speed_times_the_time_that_we_found(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    table, output = tmp_path / "steps.csv", tmp_path / "clock.mcap"
    ours = told(capsys, "replay", str(RECORDING))["moves"]
    answer = told(capsys, "replay", str(RECORDING), "--method", "clock", "--csv", str(table), "-o", str(output))
    assert answer["method"] == "clock"
    assert answer["identical"] is None
    assert isinstance(ours, list)
    moves = answer["moves"]
    assert isinstance(moves, list)
    for own, other in zip(ours, moves, strict=True):
        assert (own["kind"], own["onset_s"], own["stop_s"]) == (other["kind"], other["onset_s"], other["stop_s"])
        speed = 14.53 if own["kind"] == "push" else -35.19
        way_mm = other["end_mm"] - other["start_mm"]
        assert way_mm == pytest.approx(speed * (own["stop_s"] - own["onset_s"]), abs=0.2)
        assert other["sigma_mm"] is None
    rows = list(csv.DictReader(table.open()))
    assert {row["tier"] for row in rows} == {"settled"}
    assert rows[-1]["sigma_mm"] == "nan"
    written = Recording(output)
    assert sum(1 for _ in written.messages((SETTLED,))) == len(rows)
    assert sum(1 for _ in written.messages((MOVES,))) == len(moves)


def test_review_compares_another_method_with_the_reference_and_smooths_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    answer = told(capsys, "review", str(RECORDING), "--method", "mskf-corrected", "--csv", str(tmp_path))
    errors, moves = answer["reference"], answer["moves"]
    assert isinstance(errors, dict)
    assert isinstance(moves, list)
    assert errors["inside_95"] is None
    assert 0.0 < errors["rms_mm"] < 50.0
    assert answer["reference_smoothed"] is None
    assert [move["smoothed"] for move in moves] == [None] * 3
    assert "smoothed_displacement_mm" not in (tmp_path / "steps.csv").read_text().splitlines()[0]
    assert main(["review", str(RECORDING), "--method", "kf3"]) == 0
    printed = capsys.readouterr().out
    assert "against the reference" in printed
    assert "inside" not in printed


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["replay", str(RECORDING), "--method", "moon"], "--method moon is unknown; --method list shows what there is"),
        (["review", str(RECORDING), "--method", "mskf-papr"], "did you mean mskf-paper?"),
        (
            ["replay", str(RECORDING), "--method", "clock", "--save-state", "x.json"],
            "--save-state is for --method mskf",
        ),
        (["replay", str(RECORDING), "--method", "clock", "--provisional"], "--provisional is for --method mskf"),
        (["replay"], "name the recording to replay"),
        (["review"], "name the recording to review"),
        (["evaluate", "--method", "clock,moon"], "--method moon is unknown"),
        (["evaluate", "--method", "all", "--warm", "2"], "the others learn nothing"),
    ],
)
def test_impossible_wishes_are_refused(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("command", ["replay", "review", "evaluate"])
def test_the_methods_are_listed(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--method", "list"]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in METHODS)


def test_a_recording_too_short_for_the_transform_is_refused_in_a_sentence(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    table = tmp_path / "short.csv"
    rows = "\n".join(f"{i / 819.2},0,0,0,0,0,9.8" for i in range(1500))
    table.write_text(f"t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n{rows}\n")
    path = tmp_path / "short.mcap"
    assert main(["import", str(table), "-o", str(path)]) == 0
    capsys.readouterr()
    assert main(["replay", str(path), "--method", "mskf-paper"]) == 1
    assert "mskf-paper cannot be used on it: 1500 samples are too few for level 8" in capsys.readouterr().err


def test_evaluation_of_methods_has_a_row_for_each_whatever_the_number_of_processes(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    names = ("mskf", "clock", "integrate", "kf2")
    answer = told(
        capsys, "evaluate", "--method", ",".join(names), "--seeds", "3:5", "--scenario", "lab_bench", "--jobs", "2"
    )
    rows = answer["rows"]
    assert isinstance(rows, list)
    assert rows == json.loads(json.dumps(summarise_methods(evaluate_methods(names, ["lab_bench"], [3, 4]))))
    push = {row["method"]: row for row in rows if row["move"] == "push"}
    assert list(push) == ["mskf", OURS_INERTIAL, "clock", "integrate", "kf2"]
    assert all((row["records"], row["failures"]) == (2, 0) for row in rows)
    # What an integral of tilt and noise makes of half a minute.
    assert push["integrate"]["median_mm"] > 5 * push["clock"]["median_mm"]
    assert push["mskf"]["worst_mm"] < push["clock"]["worst_mm"]
    assert push["clock"]["cvs_mse_median_mm2_s2"] < 1.0


def test_evaluation_draws_the_papers_figures(tmp_path: Path) -> None:
    plots = tmp_path / "plots"
    asked = ["evaluate", "--method", "clock", "--scenario", "lab_bench", "--seeds", "1:2", "--plot", str(plots)]
    assert main(asked) == 0
    names = sorted(path.name for path in plots.iterdir())
    of_support = [f"lab_bench-paper-{name}.png" for name in ("a-10", "a-11", "a-9b", "c-3", "c-4", "c-5", "c-6")]
    assert names == [*of_support, "paper-a-7.png", "paper-a-8.png"]
    assert all((plots / name).read_bytes().startswith(b"\x89PNG") for name in names)
