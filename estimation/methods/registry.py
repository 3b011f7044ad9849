"""All methods by name: ours, the papers', and what they are compared with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from estimation.methods.attitude import gyro_levelled
from estimation.methods.batch import Batch, Course
from estimation.methods.clock import clock
from estimation.methods.corrected_c import corrected_c
from estimation.methods.integrate import integrate_levelled, integrate_raw
from estimation.methods.paper_c import paper_c
from estimation.methods.two_state import Tuning, three_state, tuning_of, two_state

OURS = "mskf"
# Least error over eight virtual supports whose displacement sensor is only noisy (4.7 mm); other ones are judged.
TUNED_THREE = Tuning(2.2e3, 22.0, "BqB", q_bias=11.0, bias_sigma=10.0)


@dataclass(frozen=True)
class Method:
    """One way from a record to a course; ours alone streams."""

    about: str
    course: Callable[[Batch], Course] | None = None  # raises ValueError where a record does not suffice
    reads_displacement: bool = False  # of the observed sensor


METHODS = {
    OURS: Method("this program's: streaming, all that is known of bursts, flow and displacement sensor"),
    "mskf-paper": Method("paper C to the letter: de-trending, whole-record chart, k-means, VVM - CVM - ZUPT", paper_c),
    "mskf-corrected": Method("paper C as it can work: levelled bursts, speed held between them", corrected_c),
    "kf2": Method("paper A: two states, observed displacement, the printed Q and R", two_state, True),
    "kf2-tuned": Method(
        "the same with Q and R of the configuration, as `tune` finds them",
        lambda batch: two_state(batch, tuning_of(batch.two_state)),
        True,
    ),
    "kf3": Method(
        "with a third state for the acceleration's error, levelled by the gyroscopes",
        lambda batch: three_state(batch, TUNED_THREE, gyro_levelled(batch)),
        True,
    ),
    "integrate": Method("double integration of the levelled acceleration", integrate_levelled),
    "integrate-raw": Method("double integration, turned by gravity as first felt and no more", integrate_raw),
    "clock": Method("nominal speed times the time from onset to stop", clock),
}
