"""Accuracy by Monte Carlo: the bookkeeping, on few seeds. The figures themselves belong to `make bench`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daemon.cli import main
from daemon.offline.evaluation import (
    Case,
    Instant,
    MoveScore,
    SeedResult,
    consistent_intervals,
    evaluate,
    evaluate_case,
    row_names,
    summarise,
    summarise_clock,
    virtual_support,
)
from daemon.offline.scenarios import SCENARIOS_OF_EVALUATION

CASE = Case("nominal", 3, "fused")


@pytest.fixture(scope="module")
def fused() -> SeedResult:
    return evaluate_case(CASE)


def test_a_nominal_cycle_is_scored_without_failure(fused: SeedResult) -> None:
    assert fused.failure == ""
    assert [score.kind for score in fused.moves] == ["push", "retract"]
    for score in fused.moves:
        assert abs(score.error_mm) < 4 * score.sigma_mm
        assert abs(score.onset_error_ms) < 60
        assert abs(score.stop_error_ms) < 60
        assert 0.0 < score.proposed_s < 0.3
        assert score.proposed_s < score.confirmed_s < 1.0
        assert 1.0 < score.told_s < 1.5
        for instant in (score.provisional, score.settled):
            assert abs(instant.error_mm) < 5 * instant.sigma_mm
    # A cycle's speed lies within 2.5 % (1 sigma) of nominal; the clock is off by as much.
    assert abs(fused.clock_errors_mm[0]) < 4 * 0.025 * 500


def test_results_do_not_depend_on_the_number_of_processes(fused: SeedResult) -> None:
    cases = [CASE, replace(CASE, mode="inertial")]
    results = evaluate(cases, jobs=2)
    assert [result.case for result in results] == cases
    assert results[0] == fused


def test_a_warm_up_comes_before_the_judged_cycle_and_teaches(fused: SeedResult) -> None:
    case = replace(CASE, warm_up=1)
    support = virtual_support(case)
    judged = support.placed(1)
    assert judged.start_s == pytest.approx(len(support.placed(0).t_s) / 819.2)
    warm = evaluate_case(case)
    assert warm.failure == ""
    assert warm.moves[0].sigma_mm < 0.5 * fused.moves[0].sigma_mm  # the scale of the displacement sensor is known


def test_what_is_done_to_the_readings_counts_from_the_judged_onset_and_begins_anew_each_time() -> None:
    stuck = SCENARIOS_OF_EVALUATION["can_stuck"].tampering
    assert stuck is not None
    one, other = stuck(), stuck()
    assert [one(t, v) for t, v in ((14.9, 0.2), (15.1, 0.21), (20.0, 0.3), (27.1, 0.4))] == [0.2, 0.21, 0.21, 0.4]
    assert other(16.0, 0.5) == 0.5
    dead = SCENARIOS_OF_EVALUATION["can_dead"].tampering
    assert dead is not None
    assert [dead()(t, 0.1) for t in (11.9, 12.1)] == [0.1, None]


def score_of(error_mm: float) -> MoveScore:
    return MoveScore(
        kind="push",
        error_mm=error_mm,
        sigma_mm=4.0,
        error_after_stop_mm=0.1,
        sigma_after_stop_mm=0.6,
        rmse_mm=abs(error_mm) / 2,
        smoothed_rmse_mm=abs(error_mm) / 8,
        smoothed_inside_95=0.9,
        cvs_speed_error_mm_s=0.3,
        onset_error_ms=10.0,
        stop_error_ms=-20.0,
        proposed_s=float("nan"),
        confirmed_s=0.8,
        told_s=1.2,
        provisional=Instant(error_mm, 2.0),
        settled=Instant(error_mm, 8.0),
    )


def test_summary_is_the_plain_statistics_of_the_good_records_and_counts_the_others() -> None:
    errors = [1.0, -9.0, 3.0, -5.0]
    results = [SeedResult(replace(CASE, seed=i), "", [score_of(e)], [2.0 * e]) for i, e in enumerate(errors)]
    failed = SeedResult(replace(CASE, seed=9), "1 moves found, 2 made", [score_of(500.0)], [7.0])
    row = summarise([*results, failed], 0)
    assert row["records"] == 5
    assert row["failures"] == 1
    assert row["median_mm"] == 4.0
    assert row["worst_mm"] == 9.0
    assert row["rms_mm"] == pytest.approx(np.sqrt(116 / 4))
    assert row["coverage_95"] == 0.75  # 9 mm lies beyond 1.96 x 4 mm
    assert row["nees"] == pytest.approx(116 / 4 / 16)
    assert row["provisional_nees"] == pytest.approx(116 / 4 / 4)
    assert row["settled_coverage_95"] == 1.0
    assert row["stop_median_ms"] == 20.0
    assert "proposed_median_s" not in row
    assert row["smoothed_rmse_median_mm"] == row["rmse_median_mm"] / 4 == 0.5
    assert row["smoothed_inside_95"] == pytest.approx(0.9)
    assert row["rms_of_clock"] == pytest.approx(0.5)
    assert row["rms_of_clock_95"] == pytest.approx([0.5, 0.5])
    assert summarise_clock(results, 0)["median_mm"] == 8.0
    assert summarise([failed], 0) == {"records": 1, "failures": 1}


def test_intervals_of_a_consistent_filter_hold_99_of_100_draws() -> None:
    rng = np.random.default_rng(1)
    normalised = rng.normal(size=(4000, 200))
    told = consistent_intervals(200)
    coverage = (np.abs(normalised) <= 1.959964).mean(axis=1)
    nees = (normalised**2).mean(axis=1)
    for values, (low, high) in ((coverage, told["coverage_99"]), (nees, told["nees_99"])):
        inside = np.mean((values >= low) & (values <= high))
        assert 0.985 < inside <= 1.0


def test_rows_are_named_by_what_the_moves_are() -> None:
    assert row_names("nominal") == ["push", "retract"]
    assert row_names("interrupted") == ["push 1", "push 2", "retract"]
    assert row_names("retract_not_felt") == ["push"]


def test_command_prints_rows_for_both_modes_and_the_clock_and_draws(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", "--seeds", "3:4", "--json", "--plot", str(tmp_path / "plots")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told["scenarios"]["nominal"]) == {
        f"{what} {kind}" for what in ("fused", "inertial", "clock") for kind in ("push", "retract")
    }
    assert told["failures"] == []
    assert len(told["records"]) == 2
    assert (tmp_path / "plots" / "nominal.png").read_bytes().startswith(b"\x89PNG")


def test_command_lists_its_scenarios(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--scenario", "list"]) == 0
    told = capsys.readouterr().out
    assert all(name in told for name in SCENARIOS_OF_EVALUATION)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--scenario", "moon"], "--scenario moon is unknown; --scenario list shows what there is"),
        (["--scenario", "parzial"], "--scenario parzial is unknown; did you mean partial?"),
        (["--jobs", "0"], "--jobs must be at least 1"),
        (["--warm", "-1"], "--warm must lie between 0 and 100 cycles"),
        (["--seeds", "9"], "is not of the form A:B"),
        (["--seeds", "9:3"], "holds no seed"),
        (["--plot", "/dev/null/plots"], "name a folder that can be written"),
    ],
)
def test_impossible_options_are_refused(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", *arguments]) == 2
    assert said in capsys.readouterr().err
