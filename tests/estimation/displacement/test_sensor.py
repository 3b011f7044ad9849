from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from estimation.displacement.sensor import BIASED_READINGS, STUCK_READINGS, DisplacementSensor, Reading
from estimation.records import CanState, Displacement, ReadingFault

PERIOD_S = 0.07
SPEED_M_S = 0.0145
NOISE_M = 0.003


class Feed:
    """A sensor that is fed every 70 ms."""

    def __init__(self, seed: int = 1) -> None:
        self.sensor = DisplacementSensor(NOISE_M**2, stroke_m=0.5)
        self.rng = np.random.default_rng(seed)
        self.t_s = 0.0
        self.p_m = 0.1

    @property
    def t_ns(self) -> int:
        return round(self.t_s * 1e9)

    def state(self) -> CanState:
        return self.sensor.state(self.t_ns)

    def read(self, value_m: float, *, fault: ReadingFault = ReadingFault.NONE, accepted: bool = True) -> Reading:
        self.t_s += PERIOD_S
        reading = self.sensor.judge(Displacement(self.t_ns, value_m, fault), self.p_m)
        if reading.usable:
            self.sensor.gated(accepted, value_m - self.p_m, 0.001)
        return reading

    def run(self, n: int, *, speed_m_s: float = 0.0, error_m: float = 0.0, accepted: bool = True) -> None:
        """Noisy readings of a ram at some speed."""
        for _ in range(n):
            self.p_m += speed_m_s * PERIOD_S
            self.read(self.p_m + error_m + self.rng.normal(0.0, NOISE_M), accepted=accepted)


def silent(feed: Feed) -> None:
    feed.t_s += 1.5


def late(feed: Feed) -> None:
    feed.t_s += 0.3


def not_a_number(feed: Feed) -> None:
    feed.read(math.nan)


def too_far(feed: Feed) -> None:
    feed.read(0.55)


def too_near(feed: Feed) -> None:
    feed.read(-0.05)


def stuck(feed: Feed) -> None:
    value_m = feed.p_m
    for _ in range(STUCK_READINGS):
        feed.p_m += SPEED_M_S * PERIOD_S
        feed.read(value_m)


def biased(feed: Feed) -> None:
    feed.run(BIASED_READINGS, error_m=0.03, accepted=False)


def nothing(feed: Feed) -> None: ...


@pytest.mark.parametrize(
    ("happens", "state"),
    [
        (nothing, CanState.OK),
        (late, CanState.LATE),
        (silent, CanState.SILENT),
        (not_a_number, CanState.INVALID),
        (too_far, CanState.OUT_OF_RANGE),
        (too_near, CanState.OUT_OF_RANGE),
        (stuck, CanState.STUCK),
        (biased, CanState.BIASED),
    ],
)
def test_each_illness_is_told_and_healed_by_good_readings(happens: Callable[[Feed], None], state: CanState) -> None:
    feed = Feed()
    feed.run(30, speed_m_s=SPEED_M_S)
    assert feed.state() is CanState.OK
    happens(feed)
    assert feed.state() is state
    feed.run(BIASED_READINGS, speed_m_s=SPEED_M_S)
    assert feed.state() is CanState.OK


def test_without_a_single_reading_there_is_no_sensor() -> None:
    assert DisplacementSensor(NOISE_M**2, stroke_m=0.5).state(10**12) is CanState.ABSENT


@pytest.mark.parametrize(
    ("value_m", "usable"),
    [
        (0.1, True),
        (-0.039, True),
        (0.539, True),
        (-0.041, False),
        (0.541, False),
        (math.inf, False),
        (math.nan, False),
    ],
)
def test_a_reading_without_fault_is_usable_within_the_stroke_and_a_margin(value_m: float, usable: bool) -> None:
    sensor = DisplacementSensor(NOISE_M**2, stroke_m=0.5)
    assert sensor.judge(Displacement(0, value_m), 0.1).usable is usable


STATE_OF_FAULT = {
    ReadingFault.NONE: CanState.OK,
    ReadingFault.INVALID: CanState.INVALID,
    ReadingFault.OUT_OF_RANGE: CanState.OUT_OF_RANGE,
    ReadingFault.MALFORMED: CanState.INVALID,
    ReadingFault.CHECKSUM: CanState.INVALID,
    ReadingFault.REPEATED: CanState.STUCK,
}


@pytest.mark.parametrize("value_m", [0.1, 0.9, math.inf, math.nan])
@pytest.mark.parametrize("fault", [fault for fault in ReadingFault if fault is not ReadingFault.NONE])
def test_a_reading_with_a_fault_is_never_used_and_gives_its_word_until_a_good_one_comes(
    fault: ReadingFault, value_m: float
) -> None:
    feed = Feed()
    feed.run(30)
    assert not feed.read(value_m, fault=fault).usable
    # What the source shows along with a fault says nothing more; infinity is no number without one.
    assert feed.state() is STATE_OF_FAULT[fault]
    assert feed.read(feed.p_m).usable
    assert feed.state() is CanState.OK


def test_every_fault_of_a_reading_has_its_state() -> None:
    assert set(STATE_OF_FAULT) == set(ReadingFault)


def test_nothing_is_learned_from_readings_with_a_fault() -> None:
    spoilt, plain = Feed(), Feed()
    for feed in (spoilt, plain):
        for number in range(60):
            if feed is spoilt:
                feed.sensor.judge(Displacement(feed.t_ns + 1, 0.0, ReadingFault.REPEATED), feed.p_m)
                feed.sensor.judge(Displacement(feed.t_ns + 1, 0.45, ReadingFault.REPEATED), feed.p_m)
            feed.read(0.1 + 0.001 * (number % 3))
    assert spoilt.sensor.noise_m2 == plain.sensor.noise_m2
    assert spoilt.sensor.period_s == pytest.approx(plain.sensor.period_s, rel=1e-3)


def test_the_first_good_reading_after_bad_ones_is_compared_with_none_of_them() -> None:
    late, prompt = Feed(), Feed()
    late.read(math.nan, fault=ReadingFault.MALFORMED)
    for feed in (late, prompt):
        feed.read(0.1)
        feed.read(0.1)
    assert late.sensor.noise_m2 == prompt.sensor.noise_m2
    assert late.sensor.same_in_row == prompt.sensor.same_in_row


def test_illness_of_the_value_goes_before_its_age_but_silence_before_all() -> None:
    feed = Feed()
    feed.run(30)
    too_far(feed)
    feed.t_s += 0.5
    assert feed.state() is CanState.OUT_OF_RANGE
    feed.t_s += 1.0
    assert feed.state() is CanState.SILENT


def test_a_slow_source_is_not_called_late_at_its_own_pace() -> None:
    sensor = DisplacementSensor(NOISE_M**2, stroke_m=0.5, timeout_s=2.0)
    for i in range(60):
        sensor.judge(Displacement(i * 500_000_000, 0.1 + 0.001 * (i % 2)), 0.1)
    last_ns = 59 * 500_000_000
    assert sensor.state(last_ns + 490_000_000) is CanState.OK
    assert sensor.state(last_ns + 1_600_000_000) is CanState.LATE
    assert sensor.state(last_ns + 2_100_000_000) is CanState.SILENT


def test_identical_readings_at_rest_are_what_a_quiet_sensor_gives() -> None:
    feed = Feed()
    for _ in range(500):
        assert feed.read(0.1).usable
    assert feed.state() is CanState.OK


def test_quiet_sensor_is_not_stuck_because_the_first_guess_was_far_off() -> None:
    feed = Feed()
    feed.p_m = 0.25  # stroke undetermined: the middle
    feed.read(0.1)
    feed.p_m = 0.1  # the estimate now knows
    for _ in range(20):
        assert feed.read(0.1).usable


def test_readings_that_come_before_the_first_fusion_are_no_travel() -> None:
    feed = Feed()
    for predicted_m, known in [(0.25, False)] * 4 + [(0.302, True)] * 20:
        feed.t_s += PERIOD_S
        feed.sensor.judge(Displacement(feed.t_ns, 0.3), predicted_m, known=known)
        assert feed.state() is CanState.OK


def test_quiet_sensor_is_trusted_again_when_the_estimate_takes_an_overrun_back() -> None:
    feed = Feed()
    feed.run(30)
    for _ in range(8):  # the stop has not been recognised yet
        feed.p_m += SPEED_M_S * PERIOD_S
        feed.read(0.1)
    assert feed.state() is CanState.STUCK
    feed.p_m = 0.1
    healed = [feed.read(0.1).usable for _ in range(STUCK_READINGS)]
    assert healed == [False] * (STUCK_READINGS - 1) + [True]
    assert feed.state() is CanState.OK


def test_stuck_sensor_stays_stuck_after_the_ram_has_stopped() -> None:
    feed = Feed()
    feed.run(20)
    for _ in range(30):
        feed.p_m += SPEED_M_S * PERIOD_S
        feed.read(0.1)
    for _ in range(50):
        assert not feed.read(0.1).usable
    assert feed.state() is CanState.STUCK


def test_stuck_sensor_is_not_healed_by_a_ram_that_passes_its_value() -> None:
    feed = Feed()
    feed.run(20)
    for direction in (1, -1, 1):
        for _ in range(60):
            feed.p_m += direction * SPEED_M_S * PERIOD_S / 0.4  # as fast as a retract
            feed.read(0.1)
        assert feed.state() is CanState.STUCK


def test_biased_sensor_is_compared_but_not_trusted() -> None:
    feed = Feed()
    feed.run(20)
    assert feed.read(0.101).trusted
    biased(feed)
    reading = feed.read(0.101)
    assert reading.usable
    assert not reading.trusted


def test_one_outlier_makes_no_bias_and_one_good_reading_does_not_heal_one() -> None:
    feed = Feed()
    feed.run(20)
    feed.run(BIASED_READINGS - 1, error_m=0.03, accepted=False)
    assert feed.state() is CanState.OK
    feed.run(1, error_m=0.03, accepted=False)
    assert feed.state() is CanState.BIASED
    feed.run(BIASED_READINGS - 1)
    assert feed.state() is CanState.BIASED
    feed.run(1)
    assert feed.state() is CanState.OK


@pytest.mark.parametrize("true_noise_m", [0.001, 0.003, 0.005])
def test_noise_is_learned_whatever_scale_and_offset_are(true_noise_m: float) -> None:
    sensor = DisplacementSensor(NOISE_M**2, stroke_m=0.5)
    rng = np.random.default_rng(4)
    learned = []
    for i in range(1200):
        p_m = 0.05 + 0.0003 * i
        value_m = 0.97 * p_m + 0.02 + rng.normal(0.0, true_noise_m)
        learned.append(sensor.judge(Displacement(i * 70_000_000, value_m), p_m).variance_m2)
    # Each value remembers 100 readings (variance known to 20 %), all together know it to about 5 %.
    assert math.sqrt(np.mean(learned[200:])) == pytest.approx(true_noise_m, rel=0.08)
    assert math.sqrt(learned[-1]) == pytest.approx(true_noise_m, rel=0.4)


def test_learned_noise_never_falls_below_the_resolution_nor_explodes_by_a_jump() -> None:
    feed = Feed()
    for i in range(3000):
        feed.p_m += 1e-5
        feed.read(feed.p_m + 1e-9 * (i % 2))
    assert math.sqrt(feed.sensor.noise_m2) == pytest.approx(0.0003)
    feed.read(0.5)
    assert math.sqrt(feed.sensor.noise_m2) < 0.0004


def test_a_leap_is_believed_from_no_reading_on_and_forgiven_once_it_is_taken_back() -> None:
    feed = Feed()
    feed.run(30, speed_m_s=SPEED_M_S)
    for _ in range(3):
        feed.p_m += SPEED_M_S * PERIOD_S
        reading = feed.read(feed.p_m + 0.03)
        assert reading.usable
        assert not reading.trusted
    assert feed.sensor.leapt is False  # it stays where it went
    assert feed.read(feed.p_m).trusted
    assert feed.state() is CanState.OK


def test_after_a_leap_that_lasts_the_sensor_is_biased_even_within_the_gate() -> None:
    feed = Feed()
    feed.run(30)
    feed.run(BIASED_READINGS, error_m=0.03, accepted=True)
    assert feed.state() is CanState.BIASED
    assert feed.sensor.bias_m == pytest.approx(0.03, abs=5 * NOISE_M)


@pytest.mark.parametrize("speed_m_s", [0.0145, 0.045])
def test_no_move_of_a_ram_is_a_leap_even_through_a_pause_of_the_source(speed_m_s: float) -> None:
    feed = Feed()
    feed.run(30)
    for _ in range(5):
        feed.run(10, speed_m_s=speed_m_s)
        assert not feed.sensor.leapt
        feed.t_s += 0.8
        feed.p_m += 0.8 * speed_m_s


def test_leaving_a_frozen_value_is_a_leap_but_no_reason_for_doubt() -> None:
    feed = Feed()
    feed.run(30)
    for _ in range(60):
        feed.p_m += SPEED_M_S * PERIOD_S
        feed.read(0.1)
    assert feed.state() is CanState.STUCK
    assert feed.read(feed.p_m).trusted
    assert feed.sensor.leapt
