"""Faults of the part itself: its supply, its registers, which part it is."""

from __future__ import annotations

import struct
from itertools import pairwise

import pytest

from drivers.virtual.faults import FaultScript
from tests.drivers.fault_kit import START_NS, Bench, Reading, fault, healthy, outside, script, within

HEALTHY = healthy()
HEALTHY_OUTPUTS = {reading.t_s: reading.outputs for reading in HEALTHY}
POWER_ON_S = 0.205  # data sheet


def steps(readings: list[Reading]) -> list[float]:
    return [late.t_s - early.t_s for early, late in pairwise(readings)]


@pytest.mark.parametrize("for_s", [0.001, 0.1])
def test_a_brown_out_takes_the_registers_and_205_ms(for_s: float) -> None:
    bench = Bench(script(fault("brown_out", 1.0, for_s)))
    readings = bench.read()
    back_s = round(1.0 + for_s + POWER_ON_S, 6)
    assert within(readings, 0.0, 1.0) == within(HEALTHY, 0.0, 1.0)
    assert within(readings, 1.0, back_s) == []
    later = within(readings, back_s, 3.1)
    assert [reading.t_s for reading in later] == [reading.t_s for reading in within(HEALTHY, back_s, 3.1)]
    assert all(reading.outputs == HEALTHY_OUTPUTS[reading.t_s] for reading in later)
    assert not any(reading.is_good for reading in later)  # the checksum bit is lost
    assert bench.register(0x34) == 0x0006
    assert bench.part.account().edges_lost_by_script == 0


def test_what_flash_keeps_survives_a_brown_out() -> None:
    bench = Bench(script(fault("brown_out", 1.0, 0.01)))
    bench.word(0xB804)
    bench.word(0xBE08)
    bench.clock.sleep(0.08)
    bench.word(0xB805)
    assert bench.register(0x38) == 0x0405
    bench.to(1.01 + POWER_ON_S + 0.001)
    assert [bench.register(0x38), bench.register(0x00), bench.register(0x34)] == [0x0404, 1, 0x0016]


def test_a_part_without_supply_answers_zeros_and_then_wakes() -> None:
    bench = Bench(script(fault("brown_out", 1.0, 0.1)))
    answers = {}
    for t_s in (0.999, 1.0, 1.05, 1.1, 1.1 + POWER_ON_S - 0.001, 1.1 + POWER_ON_S + 0.001):
        bench.to(t_s)
        answers[t_s] = bench.register(0x56)
    assert list(answers.values()) == [0x4040, 0, 0, 0, 0, 0x4040]


def test_a_self_test_that_loses_its_supply_is_forgotten() -> None:
    bench = Bench(script(fault("brown_out", 1.0, 0.01)), duration_s=2.0)
    bench.to(0.98)
    bench.word(0xB504)
    bench.to(1.01 + POWER_ON_S + 0.001)
    assert bench.register(0x34) == 0x0006
    assert bench.register(0x3C) & ~0x80 == 0


def test_unplugged_is_silence_and_ones_and_then_a_cold_start() -> None:
    bench = Bench(script(fault("unplugged", 1.0, 0.5)))
    readings = bench.read()
    assert outside(readings, 0.0, 1.5 + POWER_ON_S) == readings[len(within(HEALTHY, 0.0, 1.0)) :]
    assert within(readings, 1.0, 1.5 + POWER_ON_S) == []
    assert all(reading.outputs == HEALTHY_OUTPUTS[reading.t_s] for reading in readings)
    bench = Bench(script(fault("unplugged", 1.0, 0.5)))
    bench.to(1.2)
    assert bench.register(0x56) == 0xFFFF
    bench.to(1.51)
    assert bench.register(0x56) == 0
    bench.to(1.51 + POWER_ON_S)
    assert [bench.register(0x56), bench.register(0x58), bench.register(0x34)] == [0x4040, 1234, 0x0006]


def mean_outputs(readings: list[Reading]) -> list[float]:
    rows = [struct.unpack(">6h", reading.outputs[:12]) for reading in readings]
    return [sum(column) / len(rows) for column in zip(*rows, strict=True)]


def test_the_part_that_replaces_another_has_its_own_number_and_biases() -> None:
    bench = Bench(script(fault("replaced", 1.0, 0.2, serial=77, lot_id=0x12345678)))
    readings = bench.read()
    back_s = round(1.2 + POWER_ON_S, 6)
    assert within(readings, 0.0, 1.0) == within(HEALTHY, 0.0, 1.0)
    later = within(readings, back_s, 3.1)
    assert [reading.t_s for reading in later] == [reading.t_s for reading in within(HEALTHY, back_s, 3.1)]
    assert [bench.register(address) for address in (0x52, 0x54, 0x56, 0x58)] == [0x1234, 0x5678, 0x4040, 77]
    # Turn-on biases differ by 20 mg and 0.25 deg/s at one sigma: 24 and 6 counts.
    change = [new - old for new, old in zip(mean_outputs(later), mean_outputs(within(HEALTHY, 1.5, 3.1)), strict=True)]
    assert max(map(abs, change[:3])) > 3
    assert max(map(abs, change[3:])) > 12
    assert max(map(abs, change)) < 200
    # The very first samples belong to the new part, nothing of the old one is left in its filter.
    early = mean_outputs(later[:20])
    assert all(abs(one - all_) < 8 for one, all_ in zip(early, mean_outputs(later), strict=True))


def test_parts_may_be_replaced_again() -> None:
    bench = Bench(script(fault("replaced", 1.0, 0.2, serial=11), fault("replaced", 2.0, 0.2, serial=22)))
    serials = []
    for t_s in (0.9, 1.9, 2.9):
        bench.to(t_s)
        serials.append(bench.register(0x58))
    assert serials == [1234, 11, 22]


def test_a_part_that_hangs_repeats_its_registers_at_every_edge() -> None:
    bench = Bench(script(fault("repeated_samples", 1.0, 0.5)))
    readings = bench.read()
    assert [reading.t_s for reading in readings] == [reading.t_s for reading in HEALTHY]
    frozen = within(readings, 1.0, 1.5)
    assert {reading.outputs for reading in frozen} == {within(HEALTHY, 0.0, 1.0)[-1].outputs}
    assert all(reading.is_good for reading in readings)
    assert [r.outputs for r in outside(readings, 1.0, 1.5)] == [r.outputs for r in outside(HEALTHY, 1.0, 1.5)]
    assert bench.part.account().updates == 2400


def test_an_axis_beyond_its_range_shows_full_scale_and_the_flag() -> None:
    readings = Bench(
        script(fault("overrange", 1.0, 0.5, axis="y_accl"), fault("overrange", 1.2, 0.1, axis="x_gyro"))
    ).read()
    met = within(readings, 1.0, 1.5)
    assert all(reading.is_good for reading in readings)
    assert {reading.words[6] for reading in met} == {21_600}  # 18 g
    assert {reading.words[2] for reading in within(readings, 1.2, 1.3)} == {30_000}  # 1200 deg/s
    assert all(reading.words[1] & 0x10 for reading in met)
    assert [reading.words[7] for reading in met] == [reading.words[7] for reading in within(HEALTHY, 1.0, 1.5)]
    assert outside(readings, 1.0, 1.5) == outside(HEALTHY, 1.0, 1.5)


def test_the_product_number_is_wrong_meanwhile() -> None:
    bench = Bench(script(fault("wrong_product_id", 1.0, 0.5, product_id=0x4000)))
    numbers = []
    for t_s in (0.9, 1.0, 1.4, 1.5):
        bench.to(t_s)
        numbers.append(bench.register(0x56))
    assert numbers == [0x4040, 0x4000, 0x4000, 0x4040]
    assert Bench(script(fault("wrong_product_id", 1.0, 0.5))).read() == HEALTHY


def verdicts(faults: FaultScript, command: int, starts_s: tuple[float, ...]) -> list[int]:
    """DIAG_STAT after tests that start at these times."""
    bench = Bench(faults)
    found = []
    for start_s in starts_s:
        bench.to(start_s)
        bench.register(0x3C)
        bench.word(command)
        bench.clock.sleep(0.05)
        found.append(bench.register(0x3C) & ~0x80)
    return found


def test_self_tests_that_end_meanwhile_fail_by_name() -> None:
    failing = script(fault("self_test_failure", 1.0, 0.5, parts=["x_gyro", "z_accl", "memory"]))
    # The self-test takes 45 ms: one that starts just before the window ends within it.
    times_s = (0.5, 0.97, 1.2, 1.48, 1.6)
    assert verdicts(failing, 0xB504, times_s) == [0, 0x8420, 0x8420, 0, 0]
    assert verdicts(failing, 0xB508, times_s) == [0, 0, 0x40, 0, 0] or verdicts(failing, 0xB508, (0.5, 1.2)) == [
        0,
        0x40,
    ]
    both = script(
        fault("self_test_failure", 1.0, 0.5, parts=["magnetometer"]),
        fault("self_test_failure", 1.1, 0.5, parts=["barometer"]),
    )
    assert verdicts(both, 0xB504, (1.02, 1.2, 1.5)) == [0x21, 0x23, 0x22]


def test_overlapping_losses_of_supply_end_with_the_last() -> None:
    readings = Bench(script(fault("brown_out", 1.0, 0.2), fault("unplugged", 1.1, 0.3))).read()
    assert max(steps(readings)) == pytest.approx(0.4 + POWER_ON_S, abs=0.003)


def test_a_part_unplugged_for_good_ends_with_its_motion() -> None:
    bench = Bench(script(fault("unplugged", 0.0, 1000.0)))
    assert bench.read() == []
    assert bench.clock.now_ns() - START_NS == pytest.approx(3.0e9, abs=0.1e9)
    assert bench.part.account().updates == 0
