"""What the virtual part does at its pins, also to a careless driver. Raw words, without our own driver."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.adis16448.crc import burst_crc
from drivers.clock import VirtualClock
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.inertial_input import InertialInput, RecordedInput, SteadyInput
from drivers.virtual.sensor_errors import SensorErrors

GYRO_LSB = 0.04 * np.pi / 180
ACCEL_LSB = 9.80665 / 1200
PERIOD_NS = 1e9 / 819.2


class Pins:
    """A careful hand at the pins: a word every 40 us, a burst at 1 MHz."""

    def __init__(self, source: InertialInput | None = None, **part: Any) -> None:
        self.clock = VirtualClock()
        self.part = VirtualAdis16448(source or SteadyInput(), self.clock, **part)

    def word(self, word: int, *, pause_s: float = 24e-6, speed_hz: int = 1_000_000) -> int:
        answer = self.part.transfer(word.to_bytes(2, "big"), speed_hz)
        self.clock.sleep(pause_s)
        return int.from_bytes(answer, "big")

    def read(self, address: int) -> int:
        self.word(address << 8)
        return self.word(0)

    def write(self, address: int, value: int) -> None:
        self.word(0x8000 | address << 8 | value & 0xFF)
        self.word(0x8000 | (address + 1) << 8 | value >> 8)

    def burst(self, words: int = 13, speed_hz: int = 1_000_000) -> list[int]:
        """The answer words after the undefined first one."""
        answer = self.part.transfer(b"\x3e\x00" + bytes(2 * words - 2), speed_hz)
        self.clock.sleep(24e-6)
        return list(struct.unpack(f">{words}H", answer))[1:]

    def to(self, t_ns: float) -> None:
        self.clock.advance_to(round(t_ns))


def ramp(count: int, step_ns: float = PERIOD_NS) -> RecordedInput:
    """A recording whose n-th sample reads n in each gyro, accelerometer and temperature word."""
    numbers = np.arange(1, count + 1)
    column = np.repeat(numbers[:, np.newaxis], 3, axis=1)
    return RecordedInput(np.rint(numbers * step_ns), column * GYRO_LSB, column * ACCEL_LSB, 31 + numbers * 0.07386)


def without_filter(source: InertialInput, **part: Any) -> Pins:
    pins = Pins(source, **part)
    pins.write(0x38, 0x0400)
    return pins


def test_each_register_answers_its_reset_value_in_the_frame_after_the_request() -> None:
    pins = Pins(lot_id=0x18240042, serial=77)
    expected = {0x34: 6, 0x36: 1, 0x38: 0x0402, 0x3C: 0x80, 0x52: 0x1824, 0x54: 0x42, 0x56: 0x4040, 0x58: 77}
    expected |= dict.fromkeys([*range(0x1A, 0x34, 2), *range(0x40, 0x52, 2), 0x00, 0x7E], 0)
    addresses = list(expected)
    answers = [pins.word(address << 8) for address in [*addresses, 0]]
    assert dict(zip(addresses, answers[1:], strict=True)) == expected


def test_the_product_number_repeats_as_the_data_sheet_suggests_for_a_check() -> None:
    pins = Pins()
    assert [pins.word(0x5600) for _ in range(4)][1:] == [0x4040] * 3


def test_the_answer_after_a_write_is_junk() -> None:
    pins = Pins()
    pins.word(0x5600)
    assert pins.word(0xB406) == 0x4040  # the answer to the read before
    assert pins.word(0x5600) not in (0x0006, 0x4040)
    assert pins.word(0) == 0x4040


def test_writes_are_byte_by_byte_and_reserved_and_read_only_bytes_are_protected() -> None:
    pins = Pins()
    pins.word(0xA112)  # XACCL_OFF high byte
    assert pins.read(0x20) == 0x1200
    pins.word(0xA034)
    assert pins.read(0x20) == 0x1234
    for address in (0x04, 0x56, 0x3C, 0x4A, 0x7F):
        before = pins.read(address)
        pins.word(0x8000 | address << 8 | 0x55)
        assert pins.read(address) == before


def test_words_that_follow_too_fast_bring_the_old_answer_again() -> None:
    pins = Pins()
    assert [pins.word(0x5600), pins.word(0x3400), pins.word(0)][1:] == [0x4040, 0x0006]
    pins.word(0x5600)
    pins.word(0x3400, pause_s=10e-6)  # 26 us from start to start: chip select is fine, the rate is not
    assert pins.word(0x3400) == 0x4040
    pins.word(0x5600)
    assert pins.word(0, pause_s=24e-6) == 0x4040
    pins.word(0x5600, pause_s=24e-6 + 16e-6, speed_hz=500_000)
    assert pins.word(0x3400, speed_hz=4_000_000, pause_s=1e-3) != 0x4040
    pins.word(0x3800, speed_hz=400_000, pause_s=5e-6)  # 45 us from start to start, chip select too short
    assert pins.word(0, pause_s=1e-3) == 0x0006
    assert pins.read(0x34) == 0x0006  # a careful reader gets it


def test_a_burst_faster_than_1_mhz_has_wrong_words() -> None:
    pins = without_filter(ramp(200))
    pins.write(0x34, 0x0016)
    pins.to(20.2 * PERIOD_NS)
    good = pins.burst(14)
    fast = pins.burst(14, speed_hz=2_000_000)
    assert burst_crc(good[1:12]) == good[12]
    assert good[1:7] == [20] * 6
    assert fast[1:] != good[1:]
    assert burst_crc(fast[1:12]) != fast[12]


def test_a_burst_right_after_a_word_has_wrong_words() -> None:
    pins = without_filter(ramp(200))
    pins.to(20.2 * PERIOD_NS)
    pins.word(0x5600, pause_s=2e-6)
    assert pins.burst()[7:] != [1392, 0, 0xF3B0, 0xC350, 20]
    pins.to(21.2 * PERIOD_NS)
    pins.word(0x5600, pause_s=9e-6)
    assert pins.burst()[1:] == [21] * 6 + [1392, 0, 0xF3B0, 0xC350, 21]


def test_a_burst_longer_or_shorter_than_the_registers_is_cut_or_filled_with_junk() -> None:
    pins = without_filter(ramp(200))
    pins.to(20.2 * PERIOD_NS)
    assert pins.burst(5)[1:] == [20] * 3
    full = pins.burst(15)
    assert full[1:7] == [20] * 6
    assert full[12] == full[13] != burst_crc(full[1:12])


def test_a_frame_that_is_no_multiple_of_16_clocks_sets_the_flag_and_nothing_else() -> None:
    pins = Pins()
    pins.part.transfer(b"\xb8\x01\x00", 1_000_000)
    pins.clock.sleep(24e-6)
    assert pins.read(0x38) == 0x0402  # not executed
    assert pins.read(0x3C) & 0x08
    assert not pins.read(0x3C) & 0x08  # cleared by reading


def test_several_words_in_one_frame_answer_like_separate_frames() -> None:
    pins = Pins()
    answer = pins.part.transfer(b"\x56\x00\x34\x00\x00\x00", 1_000_000)
    assert struct.unpack(">3H", answer)[1:] == (0x4040, 0x0006)


def test_reset_takes_90_ms_and_restores_the_registers() -> None:
    pins = Pins()
    pins.write(0x38, 0x0104)
    pins.write(0x32, 0x0001)
    start_ns = pins.clock.now_ns()
    pins.word(0xBE80)
    line = pins.part.data_ready()
    pins.to(start_ns + 89.9e6)
    assert pins.read(0x56) == 0
    pins.to(start_ns + 90e6)
    pins.word(0x5600)
    assert pins.word(0) == 0x4040
    assert [pins.read(0x38), pins.read(0x32)] == [0x0402, 0]
    edge = line.wait(1.0)
    assert edge is not None
    assert edge.t_ns >= start_ns + 90e6


def test_a_flash_update_takes_75_ms_counts_and_survives_a_reset() -> None:
    pins = Pins()
    pins.write(0x38, 0x0404)
    pins.word(0xBE08)
    assert pins.read(0x38) == 0
    pins.clock.sleep(0.075)
    pins.word(0xBE80)
    pins.clock.sleep(0.09)
    assert pins.read(0x38) == 0x0404
    assert pins.read(0x00) == 1
    pins.write(0x1A, 0x0123)
    pins.write(0x24, 0x0045)
    pins.word(0xBE02)  # factory restore: zero offsets, flash, restart
    pins.clock.sleep(0.164)
    assert pins.read(0x56) == 0
    pins.clock.sleep(0.002)
    assert [pins.read(0x1A), pins.read(0x24), pins.read(0x00)] == [0, 0, 2]


def test_the_bias_correction_stores_the_negated_rates_in_hundredths_of_a_degree() -> None:
    pins = Pins(SteadyInput(gyro=(10 * GYRO_LSB, -3 * GYRO_LSB, 0.0)))
    pins.to(10 * PERIOD_NS)
    pins.word(0xBE01)
    pins.clock.sleep(0.08)
    assert [pins.read(0x1A), pins.read(0x1C), pins.read(0x1E)] == [0x10000 - 40, 12, 0]
    assert [pins.read(0x04), pins.read(0x06)] == [0, 0]


def test_self_test_and_memory_test_take_their_time_and_leave_their_verdict() -> None:
    pins = Pins(failing_parts=0x8041)
    pins.read(0x3C)
    start_ns = pins.clock.now_ns()
    pins.word(0xB50C)
    pins.to(start_ns + 20.1e6)
    assert pins.read(0x34) == 0x0406  # memory test over, self-test running
    assert pins.read(0x3C) & ~0x80 == 0x0040
    pins.to(start_ns + 45.1e6)
    assert pins.read(0x34) == 0x0006
    assert pins.read(0x3C) & ~0x80 == 0x8021
    assert pins.read(0x3C) & ~0x80 == 0


def test_a_full_16_bit_write_of_the_self_test_bit_loses_data_ready() -> None:
    pins = Pins()
    pins.write(0x34, 0x0400)
    pins.clock.sleep(0.05)
    assert pins.read(0x34) == 0x0000
    assert pins.part.data_ready().wait(1.0) is None


@pytest.mark.parametrize(("sens_avg", "kept"), [(0x0401, 0x0401), (0x0201, 0x0202), (0x0102, 0x0104)])
def test_a_lower_range_raises_the_taps(sens_avg: int, kept: int) -> None:
    pins = Pins()
    pins.write(0x38, sens_avg)
    assert pins.read(0x38) == kept


def test_old_silicon_ignores_the_checksum_bit() -> None:
    pins = Pins(silicon="AMLZ")
    pins.write(0x34, 0x0016)
    assert pins.read(0x34) == 0x0006


@settings(derandomize=True, deadline=None, max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_a_recording_comes_back_count_by_count(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = np.hstack([rng.integers(-30_000, 30_001, (40, 3)), rng.integers(-21_600, 21_601, (40, 3))])
    celsius = rng.integers(-700, 1000, 40)
    off = rng.uniform(-0.49, 0.49, (40, 7))
    source = RecordedInput(
        np.rint((np.arange(40) + 10) * PERIOD_NS),
        (counts[:, :3] + off[:, :3]) * GYRO_LSB,
        (counts[:, 3:] + off[:, 3:6]) * ACCEL_LSB,
        31 + (celsius + off[:, 6]) * 0.07386,
    )
    pins = without_filter(source)
    pins.write(0x34, 0x0016)
    line = pins.part.data_ready()
    read = []
    while not pins.part.exhausted:
        edge = line.wait(0.1)
        assert edge is not None
        assert edge.missed == 0
        words = pins.burst(14)
        assert burst_crc(words[1:12]) == words[12]
        read.append(words)
    rows = np.array(read)
    signed = rows[:, 1:7].astype(np.uint16).astype(np.int16)
    assert np.array_equal(signed, counts)
    assert np.array_equal(rows[:, 11], celsius & 0xFFFF)


@pytest.mark.parametrize("rate_hz", [795.0, 819.2, 844.0])
def test_data_ready_follows_the_parts_own_clock_exactly(rate_hz: float) -> None:
    pins = Pins(SteadyInput(rate_hz))
    line = pins.part.data_ready()
    times = []
    for _ in range(400):
        edge = line.wait(1.0)
        assert edge is not None
        assert edge.t_ns == pins.clock.now_ns()
        times.append(edge.t_ns)
    assert times == [round((n + 1) * 1e9 / rate_hz) for n in range(400)]


@pytest.mark.parametrize("decimation", [1, 3, 5])
def test_decimated_output_is_the_box_average_at_the_reduced_rate(decimation: int) -> None:
    size = 1 << decimation
    rng = np.random.default_rng(decimation)
    counts = rng.integers(-5000, 5000, (64 + 40 * size, 3)).astype(float)
    t_ns = np.rint((np.arange(len(counts)) + 1) * PERIOD_NS)
    pins = Pins(RecordedInput(t_ns, counts * GYRO_LSB, counts * ACCEL_LSB))
    pins.write(0x38, 0x0400)
    pins.write(0x36, decimation << 8 | 1)
    line = pins.part.data_ready()
    first = line.wait(1.0)
    assert first is not None
    # The first group begins with the first sample after the write.
    row = int(np.searchsorted(t_ns, first.t_ns)) + 1 - size
    for _ in range(30):
        words = np.array(pins.burst()[1:7], dtype=np.uint16).astype(np.int16)
        mean = counts[row : row + size].mean(axis=0)
        assert np.abs(words - np.tile(mean, 2)).max() <= 0.5 + 1e-6
        row += size
        edge = line.wait(1.0)
        assert edge is not None
        assert (edge.t_ns, edge.missed) == (t_ns[row + size - 1], 0)


@pytest.mark.parametrize(
    ("taps", "gain"),
    [(0, 1.000), (1, 0.612), (2, 0.415), (3, 0.290), (4, 0.204), (5, 0.144), (6, 0.102), (7, 0.072)],
)
def test_the_filter_lowers_white_noise_as_its_taps_say(taps: int, gain: float) -> None:
    rng = np.random.default_rng(10 + taps)
    noise = rng.normal(0, 3000, (16_384, 3))
    t_ns = np.rint((np.arange(len(noise)) + 10) * PERIOD_NS)
    pins = Pins(RecordedInput(t_ns, noise * GYRO_LSB, noise * ACCEL_LSB))
    pins.write(0x38, 0x0400 | taps)
    line = pins.part.data_ready()
    rows = []
    while line.wait(0.1) is not None:
        rows.append(pins.burst()[1:7])
    # Before its first sample the part has felt that sample for ever: leave the filter time to forget it.
    out = np.array(rows[300:], dtype=np.uint16).astype(np.int16)
    # Three independent columns of about n / taps independent values each.
    spread = np.sqrt((1 << taps) / (6 * len(noise)))
    assert np.std(out) / 3000 == pytest.approx(gain, rel=0.003 + 4 * spread)


def test_the_filter_delays_a_step_by_its_taps_less_one() -> None:
    step = np.zeros((400, 3))
    step[200:] = 640
    t_ns = np.rint((np.arange(400) + 1) * PERIOD_NS)
    pins = Pins(RecordedInput(t_ns, step * GYRO_LSB, step * ACCEL_LSB))
    pins.write(0x38, 0x0403)
    line = pins.part.data_ready()
    answers = {}
    while (edge := line.wait(0.1)) is not None:
        answers[int(np.searchsorted(t_ns, edge.t_ns))] = pins.burst()[1]
    response = [answers[200 + n] for n in range(15)]
    # Running sums of the triangle 1..8..1 over 64; the middle, row 200 + 7 - 1, lies just above one half.
    triangle = [*range(1, 9), *range(7, 0, -1)]
    assert response == [10 * s for s in np.cumsum(triangle)]
    assert answers[199] == 0


def test_offsets_are_added_just_before_the_output() -> None:
    pins = without_filter(SteadyInput(gyro=(0.0, 0.0, 5 * GYRO_LSB)))
    pins.write(0x1A, 400)  # 4 deg/s
    pins.write(0x22, 0x10000 - 1200)
    pins.clock.sleep(0.002)
    assert pins.burst()[1:7] == [100, 0, 5, 0, 0x10000 - 1200, 1200]


def test_saturation_is_flagged_and_the_flag_returns_while_it_lasts() -> None:
    pins = without_filter(SteadyInput(gyro=(30.0, 0.0, 0.0), accel=(0.0, -200.0, 0.0)))
    pins.clock.sleep(0.002)
    words = pins.burst()
    assert words[0] & 0x10
    assert (words[1], words[5]) == (30_000, 0x10000 - 21_600)
    pins.to(round(50.2 * PERIOD_NS))
    assert pins.burst()[0] & 0x10
    assert not pins.burst()[0] & 0x10  # cleared by reading, and no new sample since
    pins.to(round(51.2 * PERIOD_NS))
    assert pins.burst()[0] & 0x10


def test_field_and_pressure_are_new_every_16_samples_and_the_counter_says_when() -> None:
    pins = without_filter(ramp(200))
    line = pins.part.data_ready()
    flags, counts = [], []
    while line.wait(0.1) is not None:
        flags.append(pins.burst()[0] >> 7 & 1)
        counts.append(pins.read(0x3A))
    fresh = [n for n, flag in enumerate(flags) if flag]
    assert set(np.diff(fresh[1:])) == {16}
    assert all(counts[n] == 16 for n in fresh[1:])
    assert set(np.diff(counts)) == {-1, 15}
    assert (min(counts), max(counts)) == (1, 16)


def test_new_data_survives_a_read_of_the_status_but_not_of_the_field() -> None:
    pins = Pins()
    assert pins.read(0x3C) & 0x80
    assert pins.read(0x3C) & 0x80
    assert pins.read(0x16) == 0xC350
    assert not pins.read(0x3C) & 0x80


def test_decimation_shortens_the_field_counter_and_wakes_field_bits() -> None:
    pins = Pins()
    assert pins.read(0x14) & 0xF == 0
    pins.write(0x36, 0x0301)
    line = pins.part.data_ready()
    counts = []
    for _ in range(6):
        line.wait(1.0)
        counts.append(pins.read(0x3A))
    assert sorted(set(counts)) == [1, 2]
    assert pins.read(0x14) & 0x1 == 0
    assert pins.read(0x14) & 0xE
    pins.write(0x36, 0x0501)
    line.wait(1.0)
    assert pins.read(0x3A) == 1


def test_a_burst_that_meets_an_update_is_torn_and_its_checksum_says_so() -> None:
    pins = without_filter(ramp(400))
    pins.write(0x34, 0x0016)
    verdicts = {}
    for n, offset_us in enumerate(range(-500, 900, 20)):
        # Offsets are from the edge; the burst takes 224 us, the registers change from -210 us to 0.
        pins.to((20 + 3 * n) * PERIOD_NS + 1000 * offset_us)
        words = pins.burst(14)
        verdicts[offset_us] = (burst_crc(words[1:12]) == words[12], len(set(words[1:7])) == 1)
    clean = [offset for offset, (good, _) in verdicts.items() if good]
    assert set(clean) >= set(range(0, 780, 20)) | {-500, -480, -460, -440, -420}
    # TEMP_OUT, the last word, is read 192 us after the start and changes first; XGYRO_OUT is read after
    # 32 us and changes last.
    assert not set(clean) & set(range(-380, -59, 20))
    assert any(not same for _, same in verdicts.values())


def test_without_checksum_a_torn_burst_looks_like_any_other() -> None:
    pins = without_filter(ramp(400))
    pins.to(30 * PERIOD_NS - 200_000)
    words = pins.burst()
    assert words[1:7] != [29] * 6
    assert set(words[1:7]) <= {29, 30}
    assert words[12:] == []


def test_a_slow_burst_meets_many_updates() -> None:
    pins = without_filter(ramp(400))
    pins.to(30.1 * PERIOD_NS)
    words = pins.burst(speed_hz=20_000)  # 0.8 ms a word
    assert words[1:7] == sorted(words[1:7])
    assert words[6] > words[1] + 2


def test_data_ready_rests_when_disabled_cut_or_on_the_other_pin() -> None:
    pins = Pins()
    first, second = pins.part.data_ready(pin=1), pins.part.data_ready(pin=2)
    assert first.wait(1.0) is not None
    assert second.wait(0.01) is None
    pins.word(0xB407)
    assert second.wait(0.01) is not None
    first.wait(0.01)  # what came while the other line was waited for
    assert first.wait(0.01) is None
    pins.word(0xB402)
    second.wait(0.01)
    assert second.wait(0.01) is None
    pins.word(0xB406)
    pins.part.is_line_cut = True
    assert first.wait(0.01) is None


def test_the_wrong_polarity_takes_the_start_of_the_invalid_phase_for_its_end() -> None:
    pins = without_filter(ramp(400))
    pins.write(0x34, 0x0014)
    pins.to(5 * PERIOD_NS)
    line = pins.part.data_ready(active_high=True)
    for _ in range(5):
        edge = line.wait(1.0)
        assert edge is not None
        sample = round((edge.t_ns + 210_000) / PERIOD_NS)
        assert edge.t_ns == round(sample * PERIOD_NS) - 210_000
        words = pins.burst(14)
        assert burst_crc(words[1:12]) != words[12]
        assert edge.missed == 0
    assert pins.part.data_ready(active_high=False).wait(1.0) is not None


def test_a_late_reader_gets_the_newest_edge_and_the_count_of_the_lost_ones() -> None:
    pins = Pins()
    line = pins.part.data_ready()
    line.wait(1.0)
    pins.to(10.5 * PERIOD_NS)
    edge = line.wait(1.0)
    assert edge is not None
    assert (edge.t_ns, edge.missed) == (round(10 * PERIOD_NS), 8)
    assert pins.clock.now_ns() == round(10.5 * PERIOD_NS)  # at once
    line.close()


def test_without_its_clock_the_part_stands_still() -> None:
    pins = without_filter(ramp(3000))
    pins.word(0xB600)
    before = pins.burst()[1:7]
    assert pins.part.data_ready().wait(0.5) is None
    assert pins.burst()[1:7] == before


def test_after_its_input_the_part_holds_the_last_sample_in_silence() -> None:
    pins = without_filter(ramp(20))
    line = pins.part.data_ready()
    edges = 0
    while line.wait(0.1) is not None:
        edges += 1
    assert edges >= 17
    assert pins.part.exhausted
    assert pins.burst()[1] == 20
    assert line.wait(5.0) is None


def test_before_its_input_the_part_holds_the_first_sample_in_silence() -> None:
    source = RecordedInput([7, 8], np.full((2, 3), GYRO_LSB), np.full((2, 3), ACCEL_LSB), start_ns=500_000_000)
    pins = Pins(source)
    assert pins.part.data_ready().wait(0.4) is None
    assert pins.burst()[1:7] == [1] * 6
    assert not pins.part.exhausted


def test_an_empty_input_leaves_zeros_and_silence() -> None:
    pins = Pins(RecordedInput([], np.empty((0, 3)), np.empty((0, 3))))
    assert pins.part.data_ready().wait(1.0) is None
    pins.write(0x34, 0x0016)
    words = pins.burst(14)
    assert burst_crc(words[1:12]) == words[12]
    assert pins.part.exhausted


@pytest.mark.parametrize("stuck", [0x00, 0xFF])
def test_a_dead_data_wire_answers_one_level(stuck: int) -> None:
    pins = Pins()
    pins.part.stuck_byte = stuck
    assert pins.part.transfer(b"\x56\x00", 1_000_000) == bytes([stuck] * 2)


def test_transfers_take_the_time_of_their_bits() -> None:
    pins = Pins()
    pins.part.transfer(bytes(28), 1_000_000)
    assert pins.clock.now_ns() == 224_000
    pins.part.close()


def test_errors_are_added_before_the_registers_whatever_the_block_size() -> None:
    count = 2100  # more than two blocks
    t_ns = np.rint((np.arange(count) + 10) * PERIOD_NS)
    rest = np.zeros((count, 3))
    pins = without_filter(RecordedInput(t_ns, rest, rest), errors=SensorErrors(np.random.default_rng(1)))
    gyro, _ = SensorErrors(np.random.default_rng(1)).apply(1 / 819.2, rest, rest, np.full(count, 25.0))
    line = pins.part.data_ready()
    read = []
    while line.wait(0.1) is not None:
        read.append(np.array(pins.burst()[1:4], dtype=np.uint16).astype(np.int16))
    assert len(read) == count
    assert np.abs(np.array(read) - gyro / GYRO_LSB).max() <= 0.51


def test_a_single_sample_block_with_errors_is_fine() -> None:
    source = RecordedInput([5], np.zeros((1, 3)), np.zeros((1, 3)))
    pins = Pins(source, errors=SensorErrors(np.random.default_rng(1)))
    assert any(pins.burst()[1:7])


def test_a_recording_with_wrong_shapes_or_times_is_refused() -> None:
    with pytest.raises(ValueError, match=r"shape \(3, 3\), not \(2, 3\)"):
        RecordedInput([1, 2, 3], np.zeros((2, 3)), np.zeros((3, 3)))
    with pytest.raises(ValueError, match="must increase"):
        RecordedInput([1, 2, 2], np.zeros((3, 3)), np.zeros((3, 3)))


def test_a_steady_input_ends_after_its_duration() -> None:
    source = SteadyInput(100.0, duration_s=15.0, start_ns=1000)
    blocks = [source.block(), source.block()]
    assert [len(block.t_ns) for block in blocks if block] == [1024, 476]
    assert source.block() is None
    assert blocks[0] is not None
    assert blocks[0].t_ns[:2].tolist() == [10_001_000, 20_001_000]
