"""`ramstroke tune`: recorded moves, what is saved, the benchmark, and what people get for bad input."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import pytest

from daemon.cli import main
from daemon.configuration import load

RECORDING = Path(__file__).parents[1] / "data" / "regression" / "partial_push_and_retract.mcap"
SILENT = RECORDING.with_name("controller_falls_silent_in_a_push.mcap")
HEADER = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,observed_mm"


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> Any:
    assert main(["tune", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    code = main(["tune", *map(str, arguments)])
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return code, captured.err


def imported(folder: Path, name: str, *, with_readings: bool) -> Path:
    """Six seconds of rest."""
    rows = [
        f"{i / 800:.6f},0,0,0,0,{1e-3 * math.sin(i):.6f},9.81,{10 if with_readings and i % 50 == 0 else ''}"
        for i in range(4800)
    ]
    table = folder / f"{name}.csv"
    table.write_text("\n".join((HEADER, *rows)) + "\n")
    recording = folder / f"{name}.mcap"
    assert main(["import", str(table), "-o", str(recording)]) == 0
    return recording


def test_likelihood_and_truth_of_one_recording(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    by_likelihood = told(capsys, RECORDING, "--plot", tmp_path)
    by_truth = told(capsys, RECORDING, "--objective", "truth")
    assert (tmp_path / "tuning.png").stat().st_size > 10_000
    assert by_likelihood["moves"] == [{"file": RECORDING.name, "move": number} for number in (1, 2, 3)]
    result = by_likelihood["result"]
    assert result["log10_ratio_low"] < result["log10_ratio"] < result["log10_ratio_high"]
    assert result["log10_ratio"] == pytest.approx(math.log10(result["q"] / result["r"]))
    assert by_truth["result"]["log10_ratio_low"] is None
    errors = by_truth["rms_error_on_other_moves_mm"]
    # Whatever is tuned is judged by other moves; nothing can beat what is tuned on them.
    assert errors["best possible"] <= min(errors["tuned"], errors["Q, R of paper A"], errors["readings alone"])
    assert errors["tuned"] == pytest.approx(errors["tuned by the truth"])


def test_saved_values_are_used_by_kf2_and_keep_what_stood_in_the_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    config = tmp_path / "mine.toml"
    config.write_text("# our support 17\n[two_state]\nq = 3.0 # by hand\n\n[support]\nstroke_mm = 600.0 # long one\n")
    result = told(capsys, RECORDING, "--save", config)["result"]
    text = config.read_text()
    for kept in ("# our support 17", "stroke_mm = 600.0 # long one", "# by hand; tuned by ramstroke tune"):
        assert kept in text
    assert "3 sigma" in text
    assert RECORDING.name in text
    told(capsys, RECORDING, "--save", config)
    again = config.read_text()
    assert again.count("tuned by ramstroke tune") == 1
    assert "# by hand; tuned" in again
    settings = load(config).two_state
    assert settings.q == pytest.approx(result["q"], rel=1e-5)
    assert settings.r == pytest.approx(result["r"], rel=1e-5)

    fresh = tmp_path / "fresh.toml"
    told(capsys, RECORDING, "--save", fresh)
    assert load(fresh).two_state.q == settings.q
    assert load(fresh).support.stroke_mm == 120.0  # as the recording says

    other = tmp_path / "other.toml"
    other.write_text(fresh.read_text().replace(f"q = {settings.q}", "q = 1e-6"))
    ends = []
    for name in (fresh, other):
        assert main(["replay", str(RECORDING), "--config", str(name), "--method", "kf2-tuned", "--json"]) == 0
        ends.append(json.loads(capsys.readouterr().out)["moves"][0]["end_mm"])
    assert ends[0] != ends[1]


def test_saving_keeps_inline_tables_links_ends_of_line_and_headings(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    target, link = tmp_path / "target.toml", tmp_path / "link.toml"
    target.write_bytes(b"# ours\r\n[two_state]\r\nq = 3.0 # by hand\r\n\r\n# --- next ---\r\n[support]\r\n")
    link.symlink_to(target)
    result = told(capsys, RECORDING, "--save", link)["result"]
    assert link.is_symlink()
    text = target.read_bytes()
    assert b"# ours\r\n[two_state]\r\n" in text
    assert text.index(b"form =") < text.index(b"# --- next ---") < text.index(b"[support]")
    inline = tmp_path / "inline.toml"
    inline.write_text("two_state = {q = 1.0}\n")
    told(capsys, RECORDING, "--save", inline)
    assert load(inline).two_state.q == pytest.approx(result["q"], rel=1e-5)


def test_process_noises_of_our_own_estimator(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    config = tmp_path / "tuned.toml"
    answer = told(capsys, RECORDING, "--target", "mskf", "--budget", 4, "--save", config, "--plot", tmp_path)
    result = answer["result"]
    assert answer["moves"] == 3
    assert result["evaluations"] == 4
    assert result["value"] <= result["history"][0][1]
    estimator = load(config).estimator
    assert estimator.speed_sigma_cycle == pytest.approx(result["speed_sigma_cycle"], rel=1e-5)
    assert estimator.speed_wander == pytest.approx(result["speed_wander"], rel=1e-5)
    assert result["better"] == (result["on_other_moves_after"] < result["on_other_moves_before"])
    against_truth = told(capsys, RECORDING, "--target", "mskf", "--budget", 2, "--objective", "truth")["result"]
    assert 0 < against_truth["value"] < 100.0  # mm^2


def test_benchmark_of_the_artificial_signal_is_the_same_whatever_the_jobs(
    capsys: pytest.CaptureFixture[str],
) -> None:
    one = told(capsys, "--benchmark", "artificial", "--method", "grid", "--seeds", "0:2")
    two = told(capsys, "--benchmark", "artificial", "--method", "grid", "--seeds", "0:2", "--jobs", 2)
    assert len(one["rows"]) == 12
    assert set(one["rows"][0]) == {
        *("scenario", "variant", "method", "seed", "q", "r", "value", "optimum", "excess", "evaluations", "seconds")
    }
    assert all(abs(row["excess"]) < 1e-6 for row in one["rows"])
    for row in one["rows"] + two["rows"]:
        del row["seconds"]
    assert one["rows"] == two["rows"]


def test_benchmark_of_the_functions_prints_the_papers_figures_beside(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    answer = told(capsys, "--benchmark", "functions", "--method", "ifoa_b", "--seeds", "0:3", "--plot", tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"paper-b-4-original.png", "paper-b-4-shifted.png"}
    printed = {(row["problem"], row["variant"]): row["printed"] for row in answer["summary"]}
    assert printed["ackley", "original"] == 7.11e-15
    assert printed["ackley", "shifted"] is None
    assert {row["function"] for row in answer["rows"]} == {row["problem"] for row in answer["summary"]}
    assert main(["tune", "--benchmark", "functions", "--method", "foa", "--seeds", "0:1"]) == 0
    assert "Zettl's printed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ([], 2, "name the recordings"),
        ([RECORDING, RECORDING], 2, "named twice"),
        ([RECORDING, "--budget", "0"], 2, "--budget must be at least 1"),
        ([RECORDING, "--budget", "5"], 1, "a budget of 5 evaluations finds nothing"),
        (["--benchmark", "functions", "--method", "foa_log"], 2, "--method foa_log is for Q and R"),
        (["--benchmark", "functions", "--method", "grid"], 2, "--method grid is for Q and R"),
        (["--benchmark", "functions", "--budget", "50"], 2, "leave these options out"),
        ([RECORDING, "--jobs", "0"], 2, "--jobs must be at least 1"),
        ([RECORDING, "--seed", "-1"], 2, "--seed must not be negative"),
        ([RECORDING, "--method", "ifao_a"], 2, "did you mean ifoa_a?"),
        ([RECORDING, "--benchmark", "artificial"], 2, "name no recording"),
        ([RECORDING, "--target", "mskf", "--method", "foa"], 2, "--method is for the target kf2"),
        (["--benchmark", "artificial", "--seeds", "3:3"], 2, "holds no seed"),
        ([Path("missing.mcap")], 1, "missing.mcap"),
        ([RECORDING, "--save", Path("/proc/none/tuned.toml")], 2, "--save /proc/none/tuned.toml"),
        ([RECORDING, "--config", Path("missing.toml")], 2, "missing.toml"),
    ],
)
def test_misuse_is_told_in_one_sentence(
    capsys: pytest.CaptureFixture[str], arguments: list[object], code: int, words: str
) -> None:
    got, said = refused(capsys, *arguments)
    assert got == code
    assert words in said


def test_recordings_that_nothing_can_be_tuned_on_say_why(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    rest = imported(tmp_path, "rest", with_readings=True)
    blind = imported(tmp_path, "blind", with_readings=False)
    capsys.readouterr()
    for arguments, words in (
        ([rest], "our estimator found no move in it"),
        ([blind], "no reading of the displacement is in it"),
        ([rest, "--target", "mskf"], "0 moves are too few"),
        ([rest, "--objective", "truth"], "our estimator found no move in it"),
    ):
        code, said = refused(capsys, *arguments)
        assert code == 1
        assert words in said
        assert str(arguments[0]) in said


def test_a_broken_configuration_is_not_written_into(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    config = tmp_path / "mine.toml"
    config.write_text("[two_state]\nq = -1.0\n")
    code, said = refused(capsys, RECORDING, "--save", config)
    assert code == 2
    assert "q" in said
    assert config.read_text() == "[two_state]\nq = -1.0\n"
    assert list(tmp_path.iterdir()) == [config]


def test_methods_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["tune", "--method", "list"]) == 0
    assert "ifoa_b_log" in capsys.readouterr().out


def test_without_the_offline_packages_the_extra_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in [name for name in sys.modules if name.partition(".")[0] == "scipy"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "scipy", None)  # so an import fails
    code, said = refused(capsys, RECORDING)
    assert code == 1
    assert '`pip install ".[offline]"` in the sources' in said
