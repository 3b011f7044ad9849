"""Everything that the pipeline remembers, as one tree of plain data that survives as JSON."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from functools import cache
from math import sqrt
from typing import ClassVar

from pydantic import ConfigDict, TypeAdapter

from estimation.belief import Belief
from estimation.blocks import BlockCutter
from estimation.displacement.sensor import DisplacementSensor, Reading
from estimation.displacement.slope import Slope
from estimation.learned import Learned, Machine, prior_of
from estimation.mskf import LEARNED, Filter
from estimation.recognition.segments import SegmentRecogniser
from estimation.recognition.steps import StepBank
from estimation.records import CanState
from estimation.settings import EstimatorSettings, SupportSettings
from estimation.supervision import Supervisor
from estimation.track import Step, Track

KNOWN_START_SIGMA_M = 0.0005


@dataclass(slots=True, frozen=True)
class Start:
    """What is known before the first record: of the stroke (None = undetermined), and what an earlier run learned.

    `only_without_sensor`: believe it only if no displacement reading comes within the first seconds. A saved
    stroke may be wrong if the ram moved while nobody watched; the sensor then knows better.
    """

    displacement_m: float | None = None
    sigma_m: float = KNOWN_START_SIGMA_M
    only_without_sensor: bool = False
    learned: Learned | None = None


@dataclass(slots=True)
class PipelineState:
    """The whole memory; the two tracks differ only in how far along the buffer they are."""

    # A reading without a value is NaN, which JSON proper cannot say.
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(ser_json_inf_nan="constants")

    settled: Track
    head: Track
    sensor: DisplacementSensor
    cutter: BlockCutter = field(default_factory=BlockCutter)
    bank: StepBank | None = None
    recogniser: SegmentRecogniser = field(default_factory=SegmentRecogniser)
    supervisor: Supervisor = field(default_factory=Supervisor)
    slope: Slope = field(default_factory=Slope)
    belief: Belief = field(default_factory=Belief)
    buffer: deque[Step] = field(default_factory=deque)
    pending: list[Reading] = field(default_factory=list)
    waiting_start: Start | None = None  # to be believed if no sensor speaks
    first_ns: int | None = None
    warm_from_ns: int = 0  # when the present inertial sensor was first heard
    warm_up_s: float = 0.0  # how long nothing is recognised of it; 0 = not decided yet
    new_sensor: bool = False  # not heard yet
    last_ns: int = 0  # end of the last step
    moves: int = 0
    unexplained_in_row: int = 0  # readings at rest that a move out of the inertial sensor's reach would explain
    shown_since_ns: int | None = None  # since when the displacement sensor moves while rest is believed
    summary_due: bool = False  # a stop is certain, its move not summed up yet
    mount_checked: bool = False
    can_state: CanState = CanState.ABSENT
    can_states: deque[CanState] = field(default_factory=deque)  # beside `buffer`
    worst_in_move: CanState = CanState.ABSENT

    @classmethod
    def begin(
        cls, support: SupportSettings, settings: EstimatorSettings, start: Start, timeout_s: float
    ) -> PipelineState:
        """Before the first record. Raises ValueError if what was learned does not belong to this support."""
        stroke_m = support.stroke_mm / 1e3
        believed = Start() if start.only_without_sensor else start
        known = believed.displacement_m is not None
        track = Track.begin(
            Filter.start(
                p_m=stroke_m / 2 if believed.displacement_m is None else believed.displacement_m,
                p_sigma_m=believed.sigma_m if known else stroke_m / sqrt(12.0),
                support=support,
                settings=settings,
            )
        )
        sensor = DisplacementSensor((settings.can_noise_mm / 1e3) ** 2, stroke_m, timeout_s)
        learned = start.learned
        if learned is not None:
            learned.check(Machine.of(support), prior_of(support, settings))
            track.filter.state.set_block(LEARNED, learned.states)
            track.pushes_learned, track.retracts_learned = learned.pushes, learned.retracts
            sensor.noise_m2 = learned.noise_m**2
        return cls(
            settled=track,
            head=track.copy(),
            sensor=sensor,
            waiting_start=replace(start, learned=None) if start.only_without_sensor else None,
        )

    @property
    def strokes_learned(self) -> int:
        """How many confirmed strokes taught something that no decision can change any more."""
        return self.settled.pushes_learned + self.settled.retracts_learned

    def learned(self, machine: Machine) -> Learned | None:
        """What an estimator of the same machine may begin with; None before the first confirmed stroke.

        Without one, scale and speed cannot be told apart: there is nothing yet that is worth keeping.
        """
        if self.strokes_learned == 0:
            return None
        track = self.settled
        noise_m = sqrt(self.sensor.noise_m2)
        return Learned.of(machine, track.learned, track.pushes_learned, track.retracts_learned, noise_m)

    def dump(self) -> bytes:
        """As JSON; floats survive exactly."""
        return _adapter().dump_json(self)

    @staticmethod
    def load(snapshot: bytes) -> PipelineState:
        """From JSON. Raises pydantic.ValidationError on foreign or damaged bytes."""
        return _adapter().validate_json(snapshot)


@cache
def _adapter() -> TypeAdapter[PipelineState]:
    return TypeAdapter(PipelineState)
