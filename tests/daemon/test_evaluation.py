"""Accuracy by Monte Carlo: the bookkeeping, on few seeds. The figures themselves belong to `make bench`."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from daemon.cli import main
from daemon.offline.evaluation import MoveScore, SeedResult, evaluate, evaluate_seed, summarise, summarise_clock


@pytest.fixture(scope="module")
def fused() -> SeedResult:
    return evaluate_seed(3, "nominal", "fused")


def test_a_nominal_cycle_is_scored_without_failure(fused: SeedResult) -> None:
    assert fused.failure == ""
    assert [score.kind for score in fused.moves] == ["push", "retract"]
    for score in fused.moves:
        assert abs(score.error_mm) < 4 * score.sigma_mm
        assert abs(score.onset_error_ms) < 100
        assert abs(score.stop_error_ms) < 150
    # A cycle's speed lies within 2.5 % (1 sigma) of nominal; the clock is off by as much.
    assert abs(fused.clock_errors_mm[0]) < 4 * 0.025 * 500


def test_results_do_not_depend_on_the_number_of_processes(fused: SeedResult) -> None:
    results = evaluate("nominal", range(3, 4), jobs=2)
    assert [result.mode for result in results] == ["fused", "inertial"]
    assert results[0] == fused


def test_summary_is_the_plain_statistics_of_the_good_records_and_counts_the_others() -> None:
    def result(seed: int, error_mm: float, failure: str = "") -> SeedResult:
        score = MoveScore("push", error_mm, 4.0, 0.1, abs(error_mm) / 2, abs(error_mm) / 8, 0.9, 10.0, -20.0)
        return SeedResult(seed, "fused", failure, [score], [2.0 * error_mm])

    errors = [1.0, -9.0, 3.0, -5.0]
    results = [result(i, e) for i, e in enumerate(errors)]
    failed = replace(result(9, 500.0), failure="1 moves found, 2 made")
    row = summarise([*results, failed], "push")
    assert row["records"] == 5
    assert row["failures"] == 1
    assert row["median_mm"] == 4.0
    assert row["worst_mm"] == 9.0
    assert row["rms_mm"] == pytest.approx(np.sqrt(116 / 4))
    assert row["coverage_95"] == 0.75  # 9 mm lies beyond 1.96 x 4 mm
    assert row["nees"] == pytest.approx(116 / 4 / 16)
    assert row["stop_median_ms"] == 20.0
    assert row["smoothed_rmse_median_mm"] == row["rmse_median_mm"] / 4 == 0.5
    assert row["smoothed_inside_95"] == pytest.approx(0.9)
    assert summarise_clock(results, 0)["median_mm"] == 8.0
    assert summarise([failed], "push") == {"records": 1, "failures": 1}


def test_command_prints_rows_for_both_modes_and_the_clock(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--seeds", "3:4", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told["rows"]) == {
        f"{what} {kind}" for what in ("fused", "inertial", "clock") for kind in ("push", "retract")
    }
    assert told["failures"] == []
    assert len(told["records"]) == 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--scenario", "moon"], "--scenario moon: choose one of nominal, lab_bench"),
        (["--jobs", "0"], "--jobs must be at least 1"),
        (["--seeds", "9"], "is not of the form A:B"),
        (["--seeds", "9:3"], "holds no seed"),
    ],
)
def test_impossible_options_are_refused(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", *arguments]) == 2
    assert said in capsys.readouterr().err
