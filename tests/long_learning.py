"""What is learned over many cycles, beside the truth, as a picture: does it settle, stay, and keep an honest sigma?

python -m tests.long_learning [CYCLES [SEED [PICTURE]]]
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import matplotlib
import numpy as np

from daemon.offline.evaluation.runs import records_of
from drivers.virtual.controller import ObservedDisplacement
from drivers.virtual.support import VirtualSupport
from estimation.mskf import BOW, LATENCY, OFFSET, PUSH_FLOW, RETRACT_FLOW, SCALE
from estimation.pipeline import Pipeline, Start
from estimation.records import Move
from estimation.settings import SupportSettings

matplotlib.use("Agg")
import matplotlib.pyplot as plt

LATENCY_S = 0.0175  # what the pipeline is told


class Learned(NamedTuple):
    """One quantity of the settled state."""

    name: str
    state: int
    factor: float  # to the shown unit


QUANTITIES = (
    Learned("scale, %", SCALE, 100.0),
    Learned("offset, mm", OFFSET, 1e3),
    Learned("bow, mm", BOW, 1e3),
    Learned("latency beyond the configured, ms", LATENCY, 1e3),
    Learned("push speed, mm/s", PUSH_FLOW, 1e3),
    Learned("retract speed, mm/s", RETRACT_FLOW, 1e3),
)


def truth_of(support: VirtualSupport) -> list[float]:
    """The same quantities of the machine and its displacement sensor."""
    settings = SupportSettings()
    stroke_m = settings.stroke_mm / 1e3
    sensor = ObservedDisplacement(support.controller_parameters, np.random.default_rng(0))
    at_0, at_half, at_end = sensor.shown(np.array([0.0, stroke_m / 2, stroke_m])).tolist()
    # The average flow of many cycles: each scatters about the machine's.
    factor = support.machine.speed_factor
    return [
        (at_end - at_0) / stroke_m - 1.0,
        at_0,
        at_half - (at_0 + at_end) / 2,
        support.controller_parameters.latency_s - LATENCY_S,
        factor * settings.nominal_push_speed_mm_s / 1e3,
        factor * settings.nominal_retract_speed_mm_s / 1e3,
    ]


def main(cycles: int = 200, seed: int = 1, picture: str = "learned.png") -> None:
    """Run, print a line each tenth cycle, draw."""
    support = VirtualSupport(seed, cycles=cycles)
    truth = truth_of(support)
    pipeline = Pipeline(start=Start(0.0), latency_s=LATENCY_S)
    told: list[list[tuple[float, float]]] = []
    errors_mm: list[float] = []
    for record in records_of(support, support.observations()):
        for out in pipeline.feed(record):
            if isinstance(out, Move):
                state = pipeline.state.settled.filter.state
                told.append([(state.x[q.state], state.sigma(q.state)) for q in QUANTITIES])
                placed = support.placed((out.number - 1) // 2)
                true = placed.trajectory.moves[(out.number - 1) % 2]
                errors_mm.append((out.end_before_stop_m - true.end_m) * 1e3)
                if len(told) % 20 == 0:
                    print(
                        len(told) // 2,
                        *(f"{q.name} {x * q.factor:.3f}" for q, (x, _) in zip(QUANTITIES, told[-1], strict=True)),
                    )
    figure, axes = plt.subplots(4, 2, figsize=(12, 12), sharex=True)
    values = np.array(told)  # (moves, quantities, 2)
    number = np.arange(1, len(values) + 1) / 2
    for axis, quantity, actual, of in zip(axes.flat, QUANTITIES, truth, values.swapaxes(0, 1), strict=False):
        mean, sigma = of[:, 0] * quantity.factor, of[:, 1] * quantity.factor
        axis.fill_between(number, mean - 2 * sigma, mean + 2 * sigma, alpha=0.3, label="learned ± 2σ")
        axis.plot(number, mean)
        axis.axhline(actual * quantity.factor, color="k", lw=1, ls="--", label="truth")
        axis.set_title(quantity.name)
    axes.flat[6].plot(number, errors_mm, ".")
    axes.flat[6].set_title("error of each move's end before the stop, mm")
    axes.flat[7].axis("off")
    axes.flat[0].legend()
    axes[-1, 0].set_xlabel("cycle")
    figure.tight_layout()
    figure.savefig(picture, dpi=80)


if __name__ == "__main__":
    given = dict(enumerate(sys.argv[1:]))
    main(int(given.get(0, "200")), int(given.get(1, "1")), given.get(2, "learned.png"))
