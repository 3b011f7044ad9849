"""Faults of wires and port: what they do at the pins, and that they do nothing else."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from drivers.virtual.faults import FaultScript
from tests.drivers.fault_kit import PERIOD_NS, START_NS, Bench, Reading, fault, healthy, outside, script, within

HEALTHY = healthy()


def test_the_bench_itself_reads_every_sample_well() -> None:
    assert [reading.t_s for reading in HEALTHY] == [pytest.approx((i + 1) * PERIOD_NS / 1e9) for i in range(2400)]
    assert all(reading.is_good and reading.missed == 0 for reading in HEALTHY)
    assert len({reading.outputs for reading in HEALTHY}) > 2300


def test_a_script_without_faults_changes_no_byte_and_no_time() -> None:
    assert Bench(script()).read() == HEALTHY


@pytest.mark.parametrize(("kind", "byte"), [("miso_low", 0x00), ("miso_high", 0xFF)])
def test_a_dead_data_wire_answers_one_level_while_edges_go_on(kind: str, byte: int) -> None:
    readings = Bench(script(fault(kind, 1.0, 0.5))).read()
    assert [reading.t_s for reading in readings] == [reading.t_s for reading in HEALTHY]
    assert {reading.answer for reading in within(readings, 1.0, 1.5)} == {bytes([byte]) * 28}
    assert outside(readings, 1.0, 1.5) == outside(HEALTHY, 1.0, 1.5)


def test_of_two_levels_at_once_the_short_to_ground_wins() -> None:
    readings = Bench(script(fault("miso_low", 1.0, 0.5), fault("miso_high", 0.8, 1.0))).read()
    assert {reading.answer for reading in within(readings, 1.0, 1.5)} == {bytes(28)}
    for start_s, end_s in ((0.8, 1.0), (1.5, 1.8)):
        assert {reading.answer for reading in within(readings, start_s, end_s)} == {b"\xff" * 28}
    assert outside(readings, 0.8, 1.8) == outside(HEALTHY, 0.8, 1.8)


def flips(readings: list[Reading]) -> int:
    pairs = zip(readings, within(HEALTHY, 1.0, 2.0), strict=True)
    return sum(
        (int.from_bytes(one.answer or b"", "big") ^ int.from_bytes(other.answer or b"", "big")).bit_count()
        for one, other in pairs
    )


@pytest.mark.parametrize("probability", [1e-3, 0.02, 0.5])
def test_bits_flip_as_often_as_the_script_says(probability: float) -> None:
    readings = Bench(script(fault("bit_flips", 1.0, 1.0, probability=probability))).read()
    bits = 800 * 28 * 8
    # Binomial: four standard deviations.
    spread = 4 * (bits * probability * (1 - probability)) ** 0.5
    assert abs(flips(within(readings, 1.0, 2.0)) - bits * probability) < spread
    assert outside(readings, 1.0, 2.0) == outside(HEALTHY, 1.0, 2.0)


def test_bits_of_register_reads_flip_too() -> None:
    bench = Bench(script(fault("bit_flips", 0.0, 3.0, probability=0.1)))
    answers = {bench.register(0x56) for _ in range(50)}
    assert 0x4040 in answers
    assert len(answers) > 10


def test_a_failing_port_raises_and_the_part_goes_on() -> None:
    readings = Bench(script(fault("spi_error", 1.0, 0.5))).read()
    assert {reading.answer for reading in within(readings, 1.0, 1.5)} == {None}
    # The frames that never came left their flags in DIAG_STAT, which a burst clears.
    assert [r.outputs for r in outside(readings, 1.0, 1.5)] == [r.outputs for r in outside(HEALTHY, 1.0, 1.5)]
    some = Bench(script(fault("spi_error", 1.0, 1.0, share=0.25))).read()
    failed = sum(reading.answer is None for reading in within(some, 1.0, 2.0))
    assert 150 < failed < 250  # 200 of 800, four standard deviations


def test_a_slow_port_begins_late_and_tears_bursts() -> None:
    readings = Bench(script(fault("slow_spi", 1.0, 0.5, extra_us=1040.0))).read()
    met = within(readings, 1.0, 1.5)
    assert sum(1 + reading.missed for reading in met) == pytest.approx(400, abs=1)
    assert sum(not reading.is_good for reading in met) > 20
    assert outside(readings, 1.0, 1.51) == outside(HEALTHY, 1.0, 1.51)
    mild = Bench(script(fault("slow_spi", 1.0, 0.5, extra_us=300.0))).read()
    assert mild[-1] == HEALTHY[-1]
    assert all(reading.is_good for reading in mild)
    much = within(Bench(script(fault("slow_spi", 1.0, 0.5, extra_us=3000.0))).read(), 1.0, 1.5)
    assert sum(1 + reading.missed for reading in much) == pytest.approx(400, abs=3)
    assert len(much) < 200


def test_lost_edges_are_not_heard_of_and_not_counted_as_missed() -> None:
    bench = Bench(script(fault("data_ready_lost", 1.0, 0.5)))
    readings = bench.read()
    assert within(readings, 1.0, 1.5) == []
    # New field data and an overrange wait in DIAG_STAT for the next burst: the outputs are what must agree.
    assert [(r.t_s, r.missed, r.outputs) for r in readings] == [
        (r.t_s, r.missed, r.outputs) for r in outside(HEALTHY, 1.0, 1.5)
    ]
    account = bench.part.account()
    assert (account.updates, account.edges, account.edges_lost_by_script) == (2400, 2000, 400)


def test_a_share_of_edges_is_lost_and_the_others_arrive_in_time() -> None:
    bench = Bench(script(fault("data_ready_lost", 1.0, 1.0, share=0.3)))
    readings = bench.read()
    heard = within(readings, 1.0, 2.0)
    assert 500 < len(heard) < 620  # 560 of 800, four standard deviations
    assert all(reading.missed == 0 and reading.is_good for reading in readings)
    assert all(round(reading.t_s * 1e9) + START_NS == reading.begun_ns for reading in readings)
    account = bench.part.account()
    assert account.edges + account.edges_lost_by_script == account.updates == 2400
    assert len(readings) == account.edges


def test_a_ringing_line_tells_of_an_edge_twice() -> None:
    bench = Bench(script(fault("data_ready_doubled", 1.0, 1.0, share=0.5, after_us=400)))
    readings = bench.read()
    times = [reading.t_s for reading in readings]
    doubled = [late for early, late in pairwise(times) if late - early < 0.5 * PERIOD_NS / 1e9]
    assert all(1.0 <= t_s < 2.001 for t_s in doubled)
    assert 340 < len(doubled) < 460  # 400, four standard deviations
    account = bench.part.account()
    assert account.edges_added_by_script == len(doubled)
    assert account.edges == len(readings) == 2400 + len(doubled)
    assert all(reading.missed == 0 for reading in readings)
    echoes = set(doubled)
    assert [(r.t_s, r.outputs) for r in readings if r.t_s not in echoes] == [(r.t_s, r.outputs) for r in HEALTHY]


def test_late_edges_come_in_bunches_with_their_true_stamps() -> None:
    bench = Bench(script(fault("late_edges", 1.0, 0.5, every_ms=10.0)))
    readings = bench.read()
    met = within(readings, 1.0, 1.5)
    # Eight edges every 10 ms: the newest one is stamped when the bunch arrives.
    assert len(met) == pytest.approx(50, abs=1)
    assert sum(1 + reading.missed for reading in readings) == 2400
    assert {reading.missed for reading in met[1:-1]} == {7}
    assert outside(readings, 1.0, 1.52)[100] == outside(HEALTHY, 1.0, 1.52)[100]
    assert bench.part.account().edges == 2400
    held_up = Bench(script(fault("late_edges", 1.0, 0.503, every_ms=100.0))).read()
    lateness = [reading.begun_ns - START_NS - round(reading.t_s * 1e9) for reading in within(held_up, 1.0, 1.5)]
    assert max(lateness) < PERIOD_NS  # of the newest in a bunch


MIXTURE = (
    fault("data_ready_lost", 0.5, 2.0, share=0.2),
    fault("data_ready_doubled", 0.7, 2.0, share=0.2),
    fault("late_edges", 0.9, 0.6, every_ms=3.0),
    fault("bit_flips", 0.4, 2.0, probability=0.01),
    fault("spi_error", 1.0, 1.0, share=0.1),
    fault("slow_spi", 1.2, 0.3, extra_us=200.0),
    fault("brown_out", 1.8, 0.05),
)


def test_one_script_gives_one_run_and_another_seed_another() -> None:
    def played(faults: FaultScript) -> list[Reading]:
        return Bench(faults).read()

    once = played(script(*MIXTURE))
    assert once == played(script(*MIXTURE))
    assert once != played(script(*MIXTURE, seed=2))
    assert within(once, 0.0, 0.4) == within(HEALTHY, 0.0, 0.4)


def test_every_edge_of_a_mixture_is_accounted_for() -> None:
    bench = Bench(script(*MIXTURE))
    readings = bench.read()
    account = bench.part.account()
    assert sum(1 + reading.missed for reading in readings) == account.edges
    assert account.edges == account.updates - account.edges_lost_by_script + account.edges_added_by_script
    assert account.edges_lost_by_script > 0
    assert account.edges_added_by_script > 0
    assert account.updates < 2400 - 200  # the part was off


def test_faults_of_one_kind_that_overlap_have_their_own_chances() -> None:
    twice: tuple[dict[str, Any], ...] = (fault("data_ready_lost", 1.0, 1.0, share=0.5),) * 2
    lost = 800 - len(within(Bench(script(*twice)).read(), 1.0, 2.0))
    assert 550 < lost < 650  # 3/4 of 800, four standard deviations


@pytest.mark.parametrize("step_s", [0.0, 0.0004, 0.0031, 0.7])
def test_the_line_does_not_depend_on_how_often_it_is_asked(step_s: float) -> None:
    """Edges that a listener finds are those of the script, whoever else looks at the part meanwhile."""
    faults = script(fault("data_ready_lost", 0.2, 1.0, share=0.4), fault("brown_out", 0.5, 0.02))
    bench = Bench(faults)
    if step_s:
        while bench.clock.now_ns() < START_NS + 2.0e9:
            bench.clock.sleep(step_s)
            bench.register(0x56)
    account = (bench.read(), bench.part.account())[1]
    reference = Bench(faults)
    reference.read()
    assert account == reference.part.account()
