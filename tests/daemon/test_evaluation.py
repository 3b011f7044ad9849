"""Accuracy by Monte Carlo: the bookkeeping, on few seeds. The figures themselves belong to `make bench`."""

from __future__ import annotations

import json
import multiprocessing
import signal
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import poisson

from daemon.cli import main
from daemon.offline.evaluation.runs import evaluate, evaluate_case, virtual_support
from daemon.offline.evaluation.scenarios import SCENARIOS_OF_EVALUATION
from daemon.offline.evaluation.score import Case, Instant, MoveScore, Run, SeedResult, failure_of
from daemon.offline.evaluation.summary import (
    consistent_intervals,
    row_names,
    summarise,
    summarise_clock,
    summarise_rest,
)
from drivers.virtual.support import PlacedTrajectory
from estimation.records import CanState, Estimate, Move, MoveKind, Output, Segment, Tier
from estimation.smoothing.settled_smoother import SmoothedStep

CASE = Case("nominal", 3, "fused")


def scored(result: SeedResult) -> list[MoveScore]:
    """Its scores, all of them there."""
    told = [score for score in result.moves if score is not None]
    assert len(told) == len(result.moves)
    return told


@pytest.fixture(scope="module")
def fused() -> SeedResult:
    return evaluate_case(CASE)


def test_a_nominal_cycle_is_scored_without_failure(fused: SeedResult) -> None:
    assert fused.failure == ""
    assert [score.kind for score in scored(fused)] == ["push", "retract"]
    for score in scored(fused):
        assert abs(score.mean_speed_error_mm_s) < 1.0
        assert abs(score.error_mm) < 4 * score.sigma_mm
        assert abs(score.onset_error_ms) < 60
        assert abs(score.stop_error_ms) < 60
        assert 0.0 < score.proposed_s < 0.3
        assert score.proposed_s < score.confirmed_s < 1.0
        assert 1.0 < score.told_s < 1.5
        # Some 500 and 200 readings, white: within 25 % of 1 with more than 2 and 1.5 sigmas; quantised, so not exactly.
        assert score.nis == pytest.approx(1.0, abs=0.3)
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
    assert scored(warm)[0].sigma_mm < 0.5 * scored(fused)[0].sigma_mm  # the scale of the displacement sensor is known


def test_cases_after_one_warm_up_have_the_results_that_each_has_alone() -> None:
    cases = [Case("partial", 4, "fused", 1), Case("can_dead", 4, "fused", 1)]
    together = evaluate(cases)
    assert [result.case for result in together] == cases
    assert repr(together) == repr([evaluate_case(case) for case in cases])  # NaN is never equal


@pytest.mark.parametrize(
    ("scenario", "seed", "mode", "largest_ms"),
    [
        ("weak_burst", 10, "fused", 250),  # too soft to be felt, and shown by the displacement sensor
        # slow kernels that propose a sharp start, a first rest whose spectrum nobody knows yet
        ("partial", 1026, "fused", 60),
        ("low_frequency_rest", 1033, "fused", 60),
        ("low_frequency_rest", 2011, "fused", 60),
        ("low_frequency_rest", 2033, "inertial", 100),
        ("rough_floor", 40, "fused", 100),  # a dip right at the onset, and vibration of 1.2 m/s^2 in the push
    ],
)
def test_hard_moves_are_found_and_have_their_onset_too(scenario: str, seed: int, mode: str, largest_ms: float) -> None:
    result = evaluate_case(Case(scenario, seed, mode))
    assert result.failure == ""
    assert abs(scored(result)[0].onset_error_ms) < largest_ms


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
        mean_speed_error_mm_s=-0.2,
        onset_error_ms=10.0,
        stop_error_ms=-20.0,
        proposed_s=float("nan"),
        confirmed_s=0.8,
        told_s=1.2,
        nis=0.8 + 0.1 * error_mm,
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
    assert row["worst_mm"] == 500.0  # the failed record's, which no other figure contains
    assert row["p95_mm"] == pytest.approx(8.4)
    assert row["mean_speed_median_mm_s"] == 0.2
    assert row["rms_mm"] == pytest.approx(np.sqrt(116 / 4))
    assert row["coverage_95"] == 0.75  # 9 mm lies beyond 1.96 x 4 mm
    assert row["nees"] == pytest.approx(116 / 4 / 16)
    assert row["nis"] == pytest.approx(0.8 - 0.1 * 2.5)
    assert row["provisional_nees"] == pytest.approx(116 / 4 / 4)
    assert row["settled_coverage_95"] == 1.0
    assert row["stop_median_ms"] == 20.0
    assert "proposed_median_s" not in row
    assert row["smoothed_rmse_median_mm"] == row["rmse_median_mm"] / 4 == 0.5
    assert row["smoothed_inside_95"] == pytest.approx(0.9)
    assert row["rms_of_clock"] == pytest.approx(0.5)
    assert row["rms_of_clock_95"] == pytest.approx([0.5, 0.5])
    assert summarise_clock(results, 0)["median_mm"] == 8.0
    assert summarise([failed], 0) == {"records": 1, "failures": 1, "worst_mm": 500.0}
    assert summarise([SeedResult(CASE, "", [None])], 0) == {"records": 1, "failures": 0}


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
    assert row_names("retract_not_felt") == ["push", "retract"]


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
        (["--scenario", "nominal,moon"], "--scenario moon is unknown"),
        (["--scenario", "can_dead, can_stuck", "--no-can"], "these scenarios are about the displacement sensor"),
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


def run_of(judged: PlacedTrajectory, settled_off_m: float = 0.0) -> Run:
    """A run that says the truth at 10 Hz, but for `settled_off_m`."""
    t_s = np.arange(0.0, judged.t_s[-1] - judged.start_s, 0.1) + judged.start_s
    true_m = np.interp(t_s, judged.t_s, judged.trajectory.displacement_m)
    estimates = [
        Estimate(
            round(t * 1e9),
            p,
            0.002,
            0.0,
            0.0,
            Segment.CVS,
            tier,
            CanState.OK,
            1,
            *(0.0,) * 4,
            float("nan"),
            float("nan"),
        )
        for tier in Tier
        for t, p in zip(t_s.tolist(), (true_m + settled_off_m).tolist(), strict=True)
    ]
    steps = [SmoothedStep(e, e.displacement_m, 0.001, 0.0, 0.0, 0.0, 0.0) for e in estimates if e.tier is Tier.SETTLED]
    outputs: list[Output] = list(estimates)
    return Run(virtual_support(CASE), 0, outputs, steps)


def exact(judged: PlacedTrajectory) -> list[Move]:
    """Summaries as the truth is."""
    return [
        Move(
            number,
            MoveKind.PUSH if true.end_m > true.start_m else MoveKind.RETRACT,
            round((judged.start_s + true.onset_s) * 1e9),
            round((judged.start_s + true.stop_s) * 1e9),
            true.start_m,
            true.end_m,
            0.001,
            true.end_m,
            0.002,
            true.speed_m_s,
            CanState.OK,
            Tier.SETTLED,
        )
        for number, true in enumerate(judged.trajectory.moves, 1)
    ]


def judge(
    found: Sequence[Move], judged: PlacedTrajectory, scenario: str = "nominal", settled_off_m: float = 0.0
) -> str:
    run, truth = run_of(judged, settled_off_m), judged.trajectory.moves
    scores = [run.score(run.summary_of(true, found), true, 0.5, 0.0) for true in truth]
    return failure_of(run, list(found), truth, scores, SCENARIOS_OF_EVALUATION[scenario])


def test_a_record_fails_with_its_reason() -> None:
    judged = virtual_support(CASE).placed(0)
    push, retract = exact(judged)
    early = replace(push, number=3, onset_ns=push.onset_ns - 5_000_000_000, stop_ns=push.onset_ns - 3_000_000_000)
    late = replace(push, onset_ns=push.onset_ns + 310_000_000)
    off = replace(retract, end_before_stop_m=retract.end_before_stop_m + 0.0511)
    assert judge([push, retract], judged) == ""
    assert judge([push], judged) == "1 moves found, 2 made"
    assert judge([early, push, retract], judged) == "3 moves found, 2 made"
    assert judge([early, retract], judged) == "move 1: missed"
    assert judge([replace(push, kind=MoveKind.RETRACT), retract], judged) == "move 1: wrong direction"
    assert judge([late, retract], judged) == "move 1: onset +0.31 s off"
    assert judge([late, retract], judged, "weak_burst") == ""
    assert judge([push, replace(retract, stop_ns=retract.stop_ns - 400_000_000)], judged) == "move 2: stop -0.40 s off"
    assert judge([push, off], judged) == "move 2: +51 mm off"


def test_a_move_that_cannot_be_felt_is_judged_by_the_settled_stroke_and_may_have_a_summary() -> None:
    judged = virtual_support(CASE).placed(0)
    push, retract = exact(judged)
    assert judge([push], judged, "retract_not_felt") == ""
    assert judge([push, retract], judged, "retract_not_felt") == ""
    assert judge([push], judged, "retract_not_felt", settled_off_m=0.06) == "move 2: +60 mm off"
    missed = run_of(judged, 0.004).score(None, judged.trajectory.moves[0], 0.5, float("nan"))
    # Whatever is left of the stopping ram's swing, the settled stroke is 4 mm off.
    assert (missed.error_mm, missed.sigma_mm) == pytest.approx((4.0, 2.0), abs=1e-6)
    assert np.isnan(missed.onset_error_ms)


def test_without_sensor_an_unfelt_move_is_not_judged_and_with_it_it_is() -> None:
    alone, fused = (evaluate_case(Case("retract_not_felt", 1, mode)) for mode in ("inertial", "fused"))
    assert alone.failure == fused.failure == ""
    assert alone.moves[0] is not None
    assert alone.moves[1] is None
    push, retract = scored(fused)
    assert np.isfinite(push.onset_error_ms)
    assert np.isnan(retract.onset_error_ms)
    assert abs(retract.error_mm) < 4 * retract.sigma_mm


@pytest.mark.parametrize("count", [0, 3])
def test_false_moves_of_a_rest_are_told_per_hour_with_a_poisson_interval_failed_records_included(count: int) -> None:
    results = [
        SeedResult(CASE, "3 moves found, 1 made", rest_s=3600.0, false_moves=count),
        SeedResult(CASE, rest_s=3600.0),
    ]
    row = summarise_rest(results)
    assert (row["hours"], row["false_moves"], row["false_per_hour"]) == (2.0, count, count / 2)
    low, high = row["false_per_hour_95"]
    assert poisson.cdf(count, high * 2.0) == pytest.approx(0.025)
    assert low == 0.0 if count == 0 else poisson.sf(count - 1, low * 2.0) == pytest.approx(0.025)


def test_an_interrupt_ends_the_workers_in_the_midst_of_their_cases() -> None:
    workers = []

    def interrupt(_: float) -> None:
        workers.extend(multiprocessing.active_children())
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        evaluate([CASE, *(Case("quiet_rest", seed, "fused") for seed in range(4))], jobs=2, progress=interrupt)
    assert len(workers) == 2
    for worker in workers:
        worker.join()
    assert -signal.SIGTERM in [worker.exitcode for worker in workers]


def test_without_matplotlib_a_picture_is_refused_before_anything_is_computed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("daemon.offline.evaluation.plots.find_spec", lambda _: None)
    monkeypatch.setattr("daemon.offline.evaluation.runs.evaluate", lambda *_: pytest.fail("computed"))
    assert main(["evaluate", "--plot", str(tmp_path)]) == 1
    assert "a plot needs matplotlib" in capsys.readouterr().err
