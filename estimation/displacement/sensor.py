"""Judgement of the observed displacement: what the sensor is thought to be, and which readings may be used."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, sqrt

from estimation.records import CanState, Displacement, ReadingFault

GATE_SIGMAS = 4.5
TRUST_SIGMAS = 2.5  # a biased sensor must agree this well to be trusted again
STUCK_READINGS = 6  # identical in a row ...
STUCK_S = 0.25
STUCK_TRAVEL_M = 0.003  # ... while the piston must have moved this far ...
STUCK_WAY_M = 0.006  # ... or would have, at its speed: readings that are believed hold the prediction back
BIASED_READINGS = 8  # outside the gate in a row, and inside it again to be trusted
SHARPER_THAN_BIAS, WORSE_THAN_BIAS = 0.25, 1.5
LEAP_M, LEAP_SIGMAS = 0.008, 5.0  # between two readings, beyond what the fastest ram makes of the time
FASTEST_M_S = 0.05
LATE_PERIODS, LATE_S = 3.0, 0.15
LONGEST_PERIOD_S = 1.0  # a longer pause tells nothing of the source's rate
MARGIN_M = 0.04  # beyond the stroke: scale and offset are not known yet
NOISE_FLOOR_M = 0.0003  # half a millimetre of resolution, uniform
NOISE_MEMORY = 100  # readings

_INVALID = (ReadingFault.INVALID, ReadingFault.MALFORMED, ReadingFault.CHECKSUM)


@dataclass(slots=True)
class Reading:
    """One reading on its way through the estimator; `usable` can still be withdrawn within the buffer.

    A usable reading that is not `trusted` is only compared with the prediction.
    """

    t_ns: int
    value_m: float
    usable: bool = True
    trusted: bool = True
    variance_m2: float = 0.0


@dataclass(slots=True)
class DisplacementSensor:
    """Streaming judge. Feed every reading once, ask `state` at every step."""

    noise_m2: float
    stroke_m: float
    timeout_s: float = 1.0  # silent after this long
    noise_readings: float = 10.0  # weight of the prior
    last_ns: int | None = None
    sound: bool = False  # a reading without fault has come; the next three are of the last such
    last_value_m: float = 0.0
    last_prediction_m: float = 0.0
    last_sound_ns: int = 0
    period_s: float = 0.1
    same_in_row: int = 0
    row_began_ns: int = 0
    row_began_m: float = 0.0  # the prediction when the row of identical readings began
    row_way_m: float = 0.0  # speed times time since then
    was_known: bool = False  # whether the last prediction was worth comparing with
    near_in_row: int = 0  # readings since the prediction was last far from there
    rejected_in_row: int = 0
    accepted_in_row: int = 0
    invalid: bool = False
    repeated: bool = False  # by its own counter: as good as stuck
    out_of_range: bool = False
    stuck: bool = False
    leapt: bool = False  # the last reading, farther than a ram can go
    astray: bool = False  # since it has leapt
    before_leap_m: float = 0.0  # deviation from the prediction
    biased: bool = False
    bias_m: float = 0.0  # how far off it was found

    def judge(
        self, reading: Displacement, predicted_m: float, *, known: bool = True, velocity_m_s: float = 0.0
    ) -> Reading:
        """Take one reading in, with what the estimator expects of it; says whether it may be used.

        `known`: the prediction is more than a guess. The jump from a guess to the first fused reading is no travel.
        `velocity_m_s`: as believed now.
        """
        fault = reading.fault
        self.repeated = fault is ReadingFault.REPEATED
        if self.last_ns is not None and not self.repeated:  # copies that come in a burst tell nothing of the rate
            gap_s = (reading.t_ns - self.last_ns) * 1e-9
            if 0 < gap_s < LONGEST_PERIOD_S:
                self.period_s += 0.1 * (gap_s - self.period_s)
        self.last_ns = reading.t_ns
        self.invalid = fault in _INVALID or (reading.valid and not isfinite(reading.value_m))
        self.out_of_range = fault is ReadingFault.OUT_OF_RANGE or (
            reading.valid and not self.invalid and not -MARGIN_M <= reading.value_m <= self.stroke_m + MARGIN_M
        )
        if self.invalid or self.out_of_range or self.repeated:
            return Reading(reading.t_ns, reading.value_m, usable=False)

        self._look_for_leap(reading.value_m, predicted_m, known=known)
        first, self.sound = not self.sound, True
        if not first and reading.value_m == self.last_value_m:
            # Not the first prediction of the row: that one may have known nothing of the value yet.
            if self.same_in_row == 0 or not (known and self.was_known):
                self.row_began_m, self.row_began_ns, self.row_way_m = predicted_m, reading.t_ns, 0.0
            self.row_way_m += velocity_m_s * (reading.t_ns - max(self.last_sound_ns, self.row_began_ns)) * 1e-9
            self.same_in_row += 1
        else:
            if not first and not self.stuck and not self.astray:
                self._learn_noise(reading.value_m - predicted_m, self.last_value_m - self.last_prediction_m)
            self.same_in_row = 0
        self.last_value_m, self.last_prediction_m, self.last_sound_ns = reading.value_m, predicted_m, reading.t_ns
        self.was_known = known
        self._look_for_freezing(predicted_m)
        return Reading(
            reading.t_ns,
            reading.value_m,
            usable=not self.stuck,
            trusted=not (self.biased or self.astray),
            variance_m2=self.noise_m2,
        )

    def gated(self, accepted: bool, innovation_m: float, sigma_m: float) -> None:
        """Hear from the filter whether the reading lay within its gate, how far off it was, how sure the filter is."""
        if self.astray or (self.biased and not self._clears(innovation_m, sigma_m)):
            accepted = False
        self.accepted_in_row = self.accepted_in_row + 1 if accepted else 0
        self.rejected_in_row = 0 if accepted else self.rejected_in_row + 1
        if self.rejected_in_row >= BIASED_READINGS:
            if self.rejected_in_row <= 2 * BIASED_READINGS:
                self.bias_m = innovation_m if not self.biased else max(self.bias_m, innovation_m, key=abs)
            self.biased, self.astray = True, False
        elif self.accepted_in_row >= BIASED_READINGS:
            self.biased = False

    def _clears(self, innovation_m: float, sigma_m: float) -> bool:
        """Whether a reading speaks for the sensor: a gate that has only grown wide over time is no reason to trust it.

        Once the estimate is worse than the bias was, even a biased sensor is better than none.
        """
        bias_m = abs(self.bias_m)
        return sigma_m > WORSE_THAN_BIAS * bias_m or (
            abs(innovation_m) < 0.5 * bias_m and sigma_m < SHARPER_THAN_BIAS * bias_m
        )

    def distrust(self) -> None:
        """It has been found to run away: trust it again only when it agrees."""
        self.biased, self.accepted_in_row, self.rejected_in_row = True, 0, BIASED_READINGS

    def state(self, t_ns: int) -> CanState:
        """The sensor in one word, at time t."""
        if self.last_ns is None:
            return CanState.ABSENT
        age_s = (t_ns - self.last_ns) * 1e-9
        if age_s > self.timeout_s:
            return CanState.SILENT
        for ill, word in (
            (self.invalid, CanState.INVALID),
            (self.out_of_range, CanState.OUT_OF_RANGE),
            (self.stuck or self.repeated, CanState.STUCK),
            (self.biased, CanState.BIASED),
            (age_s > max(LATE_S, LATE_PERIODS * self.period_s), CanState.LATE),
        ):
            if ill:
                return word
        return CanState.OK

    def _look_for_freezing(self, predicted_m: float) -> None:
        """Stuck: the same value again while the ram has moved, until that proves to have been a mistake.

        A ram that merely passes the frozen value on its way back does not heal the sensor.
        """
        same = self.same_in_row > 0
        travelled = same and abs(predicted_m - self.row_began_m) >= STUCK_TRAVEL_M
        self.near_in_row = 0 if travelled else self.near_in_row + 1
        if self.stuck:
            self.stuck = same and self.near_in_row < STUCK_READINGS
        else:
            stood_s = (self.last_ns - self.row_began_ns) * 1e-9 if self.last_ns is not None else 0.0
            # A ram that has just stopped is not recognised at once.
            moved = travelled or (same and abs(self.row_way_m) >= STUCK_WAY_M)
            self.stuck = moved and self.same_in_row + 1 >= STUCK_READINGS and stood_s > STUCK_S
            if self.stuck:
                self.near_in_row = 0

    def _look_for_leap(self, value_m: float, predicted_m: float, *, known: bool) -> None:
        """No ram leaps: such a reading, and all that stay where it went, are not believed."""
        passed_s = (self.last_ns - self.last_sound_ns) * 1e-9 if self.last_ns is not None else 0.0
        limit_m = max(LEAP_M, LEAP_SIGMAS * sqrt(2.0 * self.noise_m2))
        self.leapt = self.sound and abs(value_m - self.last_value_m) > limit_m + FASTEST_M_S * passed_s
        if self.astray:
            self.astray = abs(value_m - predicted_m - self.before_leap_m) > 0.5 * limit_m
        elif self.leapt and known and self.was_known and not self.stuck and not self.biased:
            self.astray, self.before_leap_m = True, self.last_value_m - self.last_prediction_m

    def _learn_noise(self, residual_m: float, last_residual_m: float) -> None:
        """Half the mean square of successive differences: blind to scale, offset and bow."""
        difference = residual_m - last_residual_m
        sample = min(0.5 * difference * difference, 16.0 * self.noise_m2)
        self.noise_readings = min(self.noise_readings + 1.0, NOISE_MEMORY)
        self.noise_m2 += (sample - self.noise_m2) / self.noise_readings
        self.noise_m2 = max(self.noise_m2, NOISE_FLOOR_M**2)
