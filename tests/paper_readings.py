"""What each reading of paper C's undecided points makes of a push: the figures in docs/method.md.

python -m tests.paper_readings [SCENARIO [A:B]]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import numpy as np

from daemon import terminal
from daemon.offline.evaluation.methods import play
from daemon.offline.evaluation.score import STANDS_S
from estimation.methods.batch import Batch, Course
from estimation.methods.corrected_c import corrected_c
from estimation.methods.paper_c import Reading, paper_c

READINGS: dict[str, Callable[[Batch], Course]] = {
    "as printed": lambda batch: paper_c(batch),
    "limits from the mean absolute range": lambda batch: paper_c(batch, Reading(chart="moving_range")),
    "the same, k = 5": lambda batch: paper_c(batch, Reading(chart="moving_range", k=5)),
    "level 7": lambda batch: paper_c(batch, Reading(level=7)),
    "segments given": lambda batch: paper_c(batch, Reading(segments=batch.moves)),
    "segments given, (17) with VVM's third row": lambda batch: paper_c(batch, Reading(segments=batch.moves, cvm="vvm")),
    "corrected, start burst alone": lambda batch: corrected_c(batch, both_bursts=False),
    "corrected, both bursts": corrected_c,
}


def main(scenario: str, seeds: Sequence[int]) -> None:
    """Error of the push once the ram stands, and mean speed error between the bursts."""
    errors: dict[str, list[float]] = {name: [] for name in READINGS}
    speeds: dict[str, list[float]] = {name: [] for name in READINGS}
    for seed in seeds:
        played = play(scenario, seed)
        batch, judged = played.batch, played.judged
        offset_s = batch.first_ns * 1e-9 - judged.start_s
        push, t_s = judged.trajectory.moves[0], batch.t_s + offset_s
        even = (t_s > push.onset_s + 1.0) & (t_s < push.stop_s - 0.2)
        true_m_s = np.interp(t_s[even], judged.trajectory.t_s, judged.trajectory.velocity_m_s)
        for name, course_of in READINGS.items():
            try:
                course = course_of(batch)
            except ValueError:
                continue
            end_m = float(np.interp(push.stop_s + STANDS_S, t_s, course.displacement_m))
            errors[name].append((end_m - push.end_m) * 1e3)
            speeds[name].append(float(np.mean(course.velocity_m_s[even] - true_m_s)) * 1e3)
    title = f"{scenario}, {len(seeds)} supports, push of the first cycle"
    made = terminal.table(title, "reading of paper C", "median mm", "p95", "worst", "CVS speed off mm/s", "p95", "told")
    for name in READINGS:
        size, speed = np.abs(errors[name]), np.abs(speeds[name])
        made.add_row(
            name,
            *(f"{value:.0f}" for value in (np.median(size), np.percentile(size, 95), size.max())),
            *(f"{value:.2f}" for value in (np.median(speed), np.percentile(speed, 95))),
            f"{len(size)} of {len(seeds)}",
        )
    terminal.OUT.print(made)


if __name__ == "__main__":
    asked = dict(enumerate(sys.argv[1:]))
    first, _, last = asked.get(1, "1:21").partition(":")
    main(asked.get(0, "lab_bench"), range(int(first), int(last)))
