"""`ramstroke align --benchmark` with paper B's tuners: rows, pictures, misuse; and searches side by side."""

from __future__ import annotations

import json
from functools import partial
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.cli import main
from daemon.offline.alignment import benchmark as alignment_benchmark
from daemon.offline.alignment.side_by_side import side_by_side
from daemon.offline.alignment.tuning import METHODS, records_of, simulation_rows, tune_all
from estimation.alignment.scenarios import ALIGNMENTS, Alignment
from estimation.alignment.search import TUNERS
from estimation.arrays import FloatArray
from estimation.tuning.optimisers import minimize
from estimation.tuning.search import Found, Objective

SHORT = Alignment("paper_b", 40, 2, 0.1, 1, 1, height_m=40)
PNG = b"\x89PNG"


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> Any:
    capsys.readouterr()
    assert main(["align", "--benchmark", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.fixture
def one_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    """The nine settings have a test of their own."""
    monkeypatch.setattr(alignment_benchmark, "ALIGNMENTS", {"AL-8": ALIGNMENTS["AL-8"]})


# --- searches side by side --------------------------------------------------------------------------------------------


def _by(objective: Objective, method: str, budget: int) -> Found:
    return minimize(objective, [(-5.0, 5.0)], method, budget, seed=1, vectorised=True)


def test_side_by_side_is_one_after_the_other() -> None:
    def bowl(x: FloatArray, centre: float) -> FloatArray:
        return (x[:, 0] - centre) ** 2

    plans = [("pso", 100, 1.0), ("foa", 40, 2.0), ("de", 300, -1.0), ("pso", 1, 0.5)]  # some end before others
    together = side_by_side(
        [partial(_by, method=method, budget=budget) for method, budget, _ in plans],
        lambda asked: {number: bowl(x, plans[number][2]) for number, x in asked.items()},
    )
    for one, (method, budget, centre) in zip(together, plans, strict=True):
        alone = _by(lambda x, centre=centre: bowl(x, centre), method, budget)  # type: ignore[misc]
        assert (one.x.tolist(), one.value, one.history) == (alone.x.tolist(), alone.value, alone.history)
    assert side_by_side([], lambda asked: {}) == []


def test_what_a_search_raises_comes_out() -> None:
    searches = [partial(_by, method="pso", budget=100), partial(_by, method="none", budget=100)]
    with pytest.raises(ValueError, match="none is unknown"):
        side_by_side(searches, lambda asked: {number: x[:, 0] for number, x in asked.items()})


# --- tuned alignments -------------------------------------------------------------------------------------------------


def test_each_run_is_tuned_by_itself_and_the_same_again() -> None:
    records = records_of(SHORT, 3, 1)
    both = tune_all(records, ("ours", "ifoa_b", "pso_log"), 7, budget=100)
    alone = tune_all(records, ("ifoa_b",), 7, budget=100)
    np.testing.assert_array_equal(both[1].s, alone[0].s)
    np.testing.assert_allclose(both[1].course, alone[0].course, atol=1e-15)
    assert both[0].s is None
    assert both[1].s is not None
    assert len(set(both[1].s.tolist())) == 3
    assert both[0].course.shape == (20, 3, 3)
    other = tune_all(records, ("ifoa_b",), 8, budget=100)[0].s
    assert other is not None
    assert not np.array_equal(both[1].s, other)


def test_tuning_wins_nothing_on_other_records() -> None:
    """Not below the bound by more than statistics allow; ours reaches it, and claims what it reaches."""
    runs = 40
    tuned = tune_all(records_of(SHORT, runs, 3), ("ours", "foa", "ifoa_b", "pso_log"), 1, budget=200)
    rows = {(row["method"], row["axis"]): row for row in simulation_rows(tuned)}
    spread = 3 / np.sqrt(2 * runs)
    for (method, axis), row in rows.items():
        bound = rows["ours", axis]["sigma_deg"]
        assert row["rms_elsewhere_deg"] >= (1 - spread) * bound, (method, axis)
        if method == "ours":
            assert row["rms_deg"] == pytest.approx(bound, rel=spread)
            assert row["rms_deg"] == row["rms_elsewhere_deg"]
    for axis in ("pitch", "roll"):
        assert rows["foa", axis]["rms_elsewhere_deg"] > 5 * rows["ours", axis]["rms_deg"]


# --- the command ------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("one_setting")
def test_benchmark_tells_the_tuners_beside_table_3(capsys: pytest.CaptureFixture[str]) -> None:
    answer = told(capsys, "--runs", 2, "--method", "foa")
    assert [row["scenario"] for row in answer["rows"]] == ["AL-8"] * 3
    tuned = answer["tuned"]
    assert [(row["method"], row["axis"]) for row in tuned] == [("foa", axis) for axis in ("pitch", "roll", "yaw")]
    assert set(tuned[0]) == {
        *("method", "axis", "runs", "rms_deg", "rms_rad", "rms_elsewhere_deg", "sigma_deg"),
        *("q", "q_least", "q_most", "printed_rad"),
    }
    for row, printed in zip(tuned, answer["printed"]["FOA-KF"], strict=True):
        assert row["printed_rad"] == printed
        assert row["runs"] == 2
        assert row["rms_deg"] == pytest.approx(degrees(row["rms_rad"]))
        assert 1e-3 < row["q_least"] <= row["q"] <= row["q_most"] < 0.1
    pitch, roll, yaw = answer["experiment"]
    assert [one["printed_error_deg"] for one in (pitch, roll, yaw)] == [0.0098, 0.0020, 0.036]
    assert pitch["limit_deg"] == pytest.approx(degrees(0.01), rel=0.01)  # 10 mg
    assert pitch["printed_error_deg"] < roll["limit_of_reference_deg"] < pitch["limit_deg"]
    assert yaw["verdict"].startswith("refused")


@pytest.mark.usefixtures("one_setting")
def test_settings_of_tables_2_and_4_are_printed_and_pictures_drawn(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder = tmp_path / "new" / "pictures"
    assert main(["align", "--benchmark", "--runs", "2", "--method", "ours", "--plot", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "latitude 40°, height 40 m, 5 s" in said
    assert "latitude 39.84°, height 36 m, 50 s" in said
    for name in ("paper-b-5.png", "paper-b-7.png"):
        assert (folder / name).read_bytes().startswith(PNG)
        assert name in said


def test_methods_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["align", "--method", "list"]) == 0
    said = capsys.readouterr().out
    assert set(METHODS) == {"ours", *TUNERS}
    assert all(name in said for name in METHODS)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--benchmark", "--method", "gfoo"], "did you mean gfoa?"),
        (["--benchmark", "--method", "zebra"], "--method list shows"),
        (["--benchmark", "--plot", Path(__file__) / "pictures"], "name a folder that can be written"),
        (["recording.mcap", "--latitude", "40", "--method", "foa"], "--method foa is one of --benchmark"),
        (["--benchmark", "--save", "c.toml"], "--save does not go with it"),
        (["--benchmark", "--live"], "--live does not go with it"),
        (["--benchmark", "--seed", "-1"], "--seed must not be negative"),
    ],
)
def test_misuse_is_told_in_one_sentence(
    capsys: pytest.CaptureFixture[str], arguments: list[object], words: str
) -> None:
    assert main(["align", *map(str, arguments)]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert "Traceback" not in said
