"""What outlasts a run: the usual speeds of a support, and what its displacement sensor is like.

While nobody watches, each of these states wanders as an Ornstein-Uhlenbeck process about the prior of the settings.
After a time t, with the share k_i = exp(-t / memory_i) that is kept of state i,

    mean_i = prior mean_i + k_i (x_i - prior mean_i)
    P_ij   = k_i k_j P_ij + (1 - k_i k_j) prior P_ij

so the doubt grows steadily, never beyond the prior. The prior joins only states of the same memory; that keeps the
added part, and with it the sum, positive definite.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, sqrt
from typing import Annotated, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from estimation.gaussian import Gaussian
from estimation.mskf import (
    BOW,
    LATENCY,
    LEARNED,
    OFFSET,
    PUSH_FLOW,
    RETRACT_FLOW,
    SCALE,
    SENSOR,
    Filter,
)
from estimation.settings import EstimatorSettings, SupportSettings

_NAMES = {
    SCALE: "scale",
    OFFSET: "offset",
    BOW: "bow",
    LATENCY: "latency",
    PUSH_FLOW: "push_speed",
    RETRACT_FLOW: "retract_speed",
}
NAMES = tuple(_NAMES[state] for state in LEARNED)

DAY_S = 86_400.0
# Temperature and age of the fluid, wear of pump and valves: a prior of 2 % loses sqrt(2 / 90) of it, 0.3 %, in a day.
FLOW_MEMORY_S = 90 * DAY_S
# Nothing but wear and a bracket that works loose: a prior of 1 % scale loses 0.07 % in a day, 1.5 mm offset 0.1 mm.
SENSOR_MEMORY_S = 365 * DAY_S
_MEMORY_S = tuple(SENSOR_MEMORY_S if state in SENSOR else FLOW_MEMORY_S for state in LEARNED)

NOMINAL_TOLERANCE = 0.05  # a nominal speed may be corrected by so much; another pump or cylinder differs by more
# The gate of the filter lets nothing in that could bring a state so far from its prior.
IMPOSSIBLE_SIGMAS = 10.0
LEAST_VARIANCE = 1e-24  # of any state here: nothing is known better than that
ROUNDING = 1e-12  # of a correlation

_Value = Annotated[float, Field(ge=-100, le=100)]  # SI: no state here comes near


class _Frozen(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Machine(_Frozen):
    """The support that something was learned on; a text that is not known is empty.

    displacement_signal: which signal the displacement came from.
    inertial_part: which inertial sensor was there. It may be exchanged: nothing that outlasts a run depends on it.
    """

    stroke_m: float = Field(gt=0, le=10)
    push_speed_m_s: float = Field(gt=0, le=10)  # nominal, as is the next
    retract_speed_m_s: float = Field(gt=0, le=10)
    displacement_signal: str = Field("", max_length=200)
    inertial_part: str = Field("", max_length=200)

    @classmethod
    def of(cls, support: SupportSettings, displacement_signal: str = "", inertial_part: str = "") -> Machine:
        """The support as it is configured."""
        return cls(
            stroke_m=support.stroke_mm / 1e3,
            push_speed_m_s=support.nominal_push_speed_mm_s / 1e3,
            retract_speed_m_s=support.nominal_retract_speed_mm_s / 1e3,
            displacement_signal=displacement_signal,
            inertial_part=inertial_part,
        )

    def named_as(self, other: Machine) -> Machine:
        """The same with the names that only `other` knows."""
        return self.model_copy(
            update={
                "displacement_signal": self.displacement_signal or other.displacement_signal,
                "inertial_part": self.inertial_part or other.inertial_part,
            }
        )

    def difference(self, other: Machine) -> str | None:
        """What makes `other` another machine, in words; None if what was learned here holds there."""
        if self.stroke_m != other.stroke_m:
            return f"its stroke is {self.stroke_m * 1e3:g} mm, not {other.stroke_m * 1e3:g} mm"
        for word, mine, theirs in (
            ("push", self.push_speed_m_s, other.push_speed_m_s),
            ("retract", self.retract_speed_m_s, other.retract_speed_m_s),
        ):
            if abs(mine - theirs) > NOMINAL_TOLERANCE * theirs:
                return f"its nominal {word} speed is {mine * 1e3:g} mm/s, not {theirs * 1e3:g} mm/s"
        mine_, theirs_ = self.displacement_signal, other.displacement_signal
        if mine_ and theirs_ and mine_ != theirs_:
            return f"its displacement signal is {mine_!r}, not {theirs_!r}"
        return None


class Flow(NamedTuple):
    """Usual speed of one direction."""

    speed_m_s: float
    sigma_m_s: float
    moves: int  # confirmed strokes that told it


class Learned(_Frozen):
    """What is known of a machine, in SI units.

    pushes, retracts: strokes to a mechanical stop that were learned from.
    names, mean, covariance: the n states that outlast a move, jointly Gaussian; `covariance` is n by n.
    noise_m: of a displacement reading, one standard deviation.

    Raises pydantic.ValidationError (a ValueError) for what cannot have been learned, such as a covariance that is not
    positive definite.
    """

    machine: Machine
    pushes: int = Field(ge=0, le=10**9)
    retracts: int = Field(ge=0, le=10**9)
    names: tuple[str, ...]
    mean: tuple[_Value, ...]
    covariance: tuple[tuple[_Value, ...], ...]
    noise_m: float = Field(gt=0, le=1)

    @classmethod
    def of(cls, machine: Machine, states: Gaussian, pushes: int, retracts: int, noise_m: float) -> Learned:
        """From the states of a filter."""
        p = states.p  # symmetric but for rounding
        return cls(
            machine=machine,
            pushes=pushes,
            retracts=retracts,
            names=NAMES,
            mean=tuple(states.x),
            covariance=tuple(tuple(0.5 * (a + p[j][i]) for j, a in enumerate(row)) for i, row in enumerate(p)),
            noise_m=noise_m,
        )

    @model_validator(mode="after")
    def _hangs_together(self) -> Self:
        n = len(NAMES)
        if self.names != NAMES:
            raise ValueError(f"these are not the states {', '.join(NAMES)}")
        if len(self.mean) != n or len(self.covariance) != n or any(len(row) != n for row in self.covariance):
            raise ValueError(f"mean and covariance are not those of {n} states")
        if not is_positive_definite(self.covariance):
            raise ValueError("the covariance is not positive definite")
        if self.calibrations == 0:
            raise ValueError("no stroke was learned from")
        return self

    @property
    def states(self) -> Gaussian:
        """The states in the order of `mskf.LEARNED`."""
        return Gaussian(list(self.mean), [list(row) for row in self.covariance])

    @property
    def push(self) -> Flow:
        """What is known of pushes."""
        return Flow(*self.value("push_speed"), self.pushes)

    @property
    def retract(self) -> Flow:
        """What is known of retracts."""
        return Flow(*self.value("retract_speed"), self.retracts)

    @property
    def calibrations(self) -> int:
        """Confirmed stops that the displacement sensor was compared with."""
        return self.pushes + self.retracts

    def value(self, name: str) -> tuple[float, float]:
        """Mean and standard deviation of one state."""
        i = self.names.index(name)
        return self.mean[i], sqrt(self.covariance[i][i])

    def check(self, machine: Machine, prior: Gaussian) -> None:
        """Whether it holds for `machine`. Raises ValueError with the reason if not."""
        difference = self.machine.difference(machine)
        if difference is not None:
            raise ValueError(f"learned on another machine ({difference})")
        for i, (name, mean) in enumerate(zip(self.names, self.mean, strict=True)):
            if abs(mean - prior.x[i]) > IMPOSSIBLE_SIGMAS * prior.sigma(i):
                raise ValueError(f"its {name} of {mean:g} cannot have been learned from {prior.x[i]:g}")

    def inflated(self, elapsed_s: float, prior: Gaussian) -> Learned:
        """What is left of it after `elapsed_s` unwatched; `prior`: what would be assumed had nothing been learned."""
        n = range(len(self.mean))
        keep = [exp(-max(elapsed_s, 0.0) / memory_s) for memory_s in _MEMORY_S]
        # Settings may have become more certain than this was.
        cap = [min(1.0, prior.sigma(i) / sqrt(self.covariance[i][i])) for i in n]
        mean = (prior.x[i] + keep[i] * (self.mean[i] - prior.x[i]) for i in n)
        covariance = (
            tuple(
                keep[i] * keep[j] * cap[i] * cap[j] * self.covariance[i][j] + (1.0 - keep[i] * keep[j]) * prior.p[i][j]
                for j in n
            )
            for i in n
        )
        return self.model_copy(update={"mean": tuple(mean), "covariance": tuple(covariance)})


def prior_of(support: SupportSettings, settings: EstimatorSettings) -> Gaussian:
    """What is assumed of the states that outlast a move before anything was learned."""
    return Filter.start(0.0, 0.0, support, settings).state.block(LEARNED)


def is_positive_definite(matrix: Sequence[Sequence[float]]) -> bool:
    """Whether a square matrix is a covariance: symmetric, and Cholesky's decomposition of its correlations exists."""
    sigma = [sqrt(max(row[i], 0.0)) for i, row in enumerate(matrix)]
    if any(s * s < LEAST_VARIANCE for s in sigma):
        return False
    lower: list[list[float]] = []
    for i, row in enumerate(matrix):
        found: list[float] = []
        for j in range(i + 1):
            scale = sigma[i] * sigma[j]
            if abs(row[j] - matrix[j][i]) > ROUNDING * scale:
                return False
            rest = row[j] / scale - sum(a * b for a, b in zip(found, lower[j] if j < i else found, strict=False))
            if j < i:
                found.append(rest / lower[j][j])
            elif rest > ROUNDING:
                found.append(sqrt(rest))
            else:
                return False
        lower.append(found)
    return True
