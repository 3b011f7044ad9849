"""Virtual sensors at rest, AL-1 to AL-9: errors beside what theory allows, and beside what paper B prints."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from daemon.offline.alignment.grades import load_grades
from estimation.alignment.scenarios import ALIGNMENTS, play
from estimation.alignment.verdict import verdicts

# Paper B, Table 3: error in pitch, roll, yaw; the unit is not printed.
PRINTED = {
    "PSO-KF": (0.000050336, 0.000065926, 0.000045396),
    "FOA-KF": (0.000047334, 0.000062827, 0.000006588),
    "GFOA-KF": (0.000042335, 0.000057818, 0.000004314),
    "IFOA-KF": (0.000036726, 0.000052809, 0.000000242),
}


def benchmark(runs: int, seed: int, progress: Callable[[int], None] | None = None) -> list[dict[str, Any]]:
    """A row for each setting and axis; the posterior sigma of the right model is the bound (Cramér and Rao)."""
    grades, rows = load_grades(), []
    for done, (name, case) in enumerate(ALIGNMENTS.items(), 1):
        grade = grades[case.grade]
        aligned = play(case, grade, runs, seed)
        told = verdicts(aligned.sigma, case.prior, grade, case.place)
        rms = np.sqrt((aligned.errors**2).mean(axis=0))
        for axis, verdict, one_rms, sigma in zip(("east", "north", "up"), told, rms, aligned.sigma, strict=True):
            rows.append(
                {
                    "scenario": name,
                    "about": f"{case.grade}, {case.latitude_deg:g}°, {case.duration_s:g} s",
                    "runs": runs,
                    "axis": axis,
                    "rms_deg": float(np.degrees(one_rms)),
                    "bound_deg": float(np.degrees(sigma)),
                    "nees": float(aligned.nees.mean()) / 3,
                    "verdict": str(verdict),
                }
            )
        if progress is not None:
            progress(done)
    return rows
