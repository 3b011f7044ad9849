"""Paper B's tuners on virtual sensors at rest beside the process noise that is right: its Tables 2 to 4."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from daemon.offline.alignment.benchmark import PRINTED
from daemon.offline.alignment.grades import load_grades
from daemon.offline.alignment.side_by_side import side_by_side
from estimation.alignment.attitude import to_angles
from estimation.alignment.candidates import Records, each_step
from estimation.alignment.scenarios import ALIGNMENTS, EXPERIMENT, Alignment, Resting, play
from estimation.alignment.search import BUDGET, OURS, TUNERS, search_s
from estimation.alignment.verdict import limits, verdicts
from estimation.arrays import FloatArray
from estimation.tuning.particles import PARTICLES

AXES = ("pitch", "roll", "yaw")
METHODS = {OURS: "the sensor's own angle and velocity random walk; no search"} | {
    name: tuner.about for name, tuner in TUNERS.items()
}
PRINTED_NAME = {"pso": "PSO-KF", "foa": "FOA-KF", "gfoa": "GFOA-KF", "ifoa_b": "IFOA-KF"}
AS_PRINTED = (OURS, *PRINTED_NAME)
SIMULATION = ALIGNMENTS["AL-8"]
# Paper B, the experiment: |final - "true"| as printed, of pitch, roll, yaw [deg]; 0.0415 - 0.004 is 0.0375, not 0.036.
PRINTED_EXPERIMENT_DEG = (0.0098, 0.0020, 0.036)
GENERATIONS = BUDGET // PARTICLES


@dataclass(frozen=True)
class Tuned:
    """What a method found on each record, and what the alignment made of it."""

    method: str
    s: FloatArray | None  # (runs,); None: no search
    course: FloatArray  # (steps, runs, 3) error in pitch, roll, yaw [rad]
    sigma: FloatArray  # (steps, 3) claimed, rms over the runs [rad]
    elsewhere: FloatArray  # (runs, 3) error at the end [rad] on the next run's record, which it was not tuned on


def records_of(case: Alignment, runs: int, seed: int) -> Records:
    """Virtual sensors of a setting."""
    return Records(Resting(case, load_grades()[case.grade], runs, seed))


def tune_all(
    records: Records,
    methods: Sequence[str],
    seed: int,
    progress: Callable[[int], None] | None = None,
    budget: int = BUDGET,
) -> list[Tuned]:
    """Each method on each record by itself, as paper B does on its only one: tuned and judged on the same record."""
    runs = records.sensors.runs
    cases = [(method, run) for method in methods if method != OURS for run in range(runs)]
    generation = 0

    def evaluate(candidates: dict[int, FloatArray]) -> dict[int, FloatArray]:
        nonlocal generation
        sizes = [len(s) for s in candidates.values()]
        run = np.repeat([cases[number][1] for number in candidates], sizes)
        fitness = records.fitness(run, np.concatenate(list(candidates.values())))
        generation += 1
        if progress is not None:
            progress(generation)
        return dict(zip(candidates, np.split(fitness, np.cumsum(sizes)[:-1]), strict=True))

    searches = [partial(search_s, method=method, seed=seed + run, budget=budget) for method, run in cases]
    found = dict(zip(cases, side_by_side(searches, evaluate), strict=True))
    tuned = []
    for method in methods:
        s = None if method == OURS else np.array([found[method, run].x[0] for run in range(runs)])
        noise = np.tile(records.ours, (runs, 1)) if s is None else each_step(s)
        elsewhere, _ = _judged(records, np.roll(noise, 1, axis=0))
        tuned.append(Tuned(method, s, *_judged(records, noise), elsewhere[-1]))
    return tuned


def _judged(records: Records, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors (steps, runs, 3) and claimed sigmas (steps, 3); level sigmas of east and north are alike."""
    true = np.stack(to_angles(records.sensors.true), axis=-1)
    errors, sigma = [], []
    for fine in records.align(np.arange(len(noise)), noise):
        off = np.stack(to_angles(fine.attitude), axis=-1) - true
        errors.append((off + np.pi) % (2 * np.pi) - np.pi)
        sigma.append(np.sqrt((fine.sigma**2).mean(axis=0)))
    return np.array(errors), np.array(sigma)


def simulation_rows(tuned: Sequence[Tuned]) -> list[dict[str, Any]]:
    """A row for each method and angle, at the end of the record, beside paper B's Table 3."""
    rows = []
    for one in tuned:
        rms, elsewhere = (np.sqrt((errors**2).mean(axis=0)) for errors in (one.course[-1], one.elsewhere))
        printed = PRINTED.get(PRINTED_NAME.get(one.method, ""))
        for i, axis in enumerate(AXES):
            rows.append(
                {
                    "method": one.method,
                    "axis": axis,
                    "runs": one.course.shape[1],
                    "rms_deg": float(np.degrees(rms[i])),
                    "rms_rad": float(rms[i]),
                    "rms_elsewhere_deg": float(np.degrees(elsewhere[i])),
                    "sigma_deg": float(np.degrees(one.sigma[-1, i])),
                    "q": None if one.s is None else float(np.median(one.s)),
                    "q_least": None if one.s is None else float(one.s.min()),
                    "q_most": None if one.s is None else float(one.s.max()),
                    "printed_rad": None if printed is None else printed[i],
                }
            )
    return rows


def experiment_rows(runs: int, seed: int) -> list[dict[str, Any]]:
    """A row for each angle of a JY901 that rests as in paper B's Table 4, beside the printed errors and the limits."""
    case, grades = EXPERIMENT, load_grades()
    grade, place = grades[case.grade], case.place
    aligned = play(case, grade, runs, seed)
    told = verdicts(aligned.sigma, case.prior, grade, place)
    rms = np.sqrt((aligned.errors**2).mean(axis=0))
    bound, of_truth = limits(grade, place), limits(grades["adis16448_in_run"], place)
    return [
        {
            "axis": axis,
            "runs": runs,
            "rms_deg": float(np.degrees(rms[i])),
            "sigma_deg": float(np.degrees(aligned.sigma[i])),
            "limit_deg": float(np.degrees(bound.heading if axis == "yaw" else bound.level)),
            "limit_of_reference_deg": float(np.degrees(of_truth.heading if axis == "yaw" else of_truth.level)),
            "printed_error_deg": PRINTED_EXPERIMENT_DEG[i],
            "verdict": str(told[i]),
        }
        for i, axis in enumerate(AXES)
    ]
