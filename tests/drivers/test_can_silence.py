"""A link that is up, but gives nothing, or nothing that is wanted, says so and says where to look."""

from __future__ import annotations

import pytest

from drivers.can.bus import CanBus
from drivers.can.frame import FrameId
from drivers.can.settings import CanSettings, DisplacementSettings
from drivers.clock import VirtualClock
from drivers.condition import OK, Wellness
from drivers.virtual.can_network import NetworkBus
from tests.drivers.can_bench import Bench, message, nobody, unused_channel


def let_pass(bench: Bench, clock: VirtualClock, seconds: float, *identifiers: int) -> None:
    """Time passes, and every 0.1 s each of `identifiers` is sent."""
    for _ in range(round(seconds * 10)):
        clock.sleep(0.1)
        for identifier in identifiers:
            bench.peer.send(message(identifier))
        bench.link.drain()


def opened(clock: VirtualClock, *ids: FrameId) -> Bench:
    bench = Bench(clock=clock, ids=ids)
    bench.link.drain()
    return bench


def test_no_frame_at_all() -> None:
    clock = VirtualClock()
    bench = opened(clock, FrameId(0x310))
    let_pass(bench, clock, 4.9)
    assert bench.link.condition == OK
    let_pass(bench, clock, 2.1)
    condition = bench.link.condition
    assert condition.word is Wellness.WAITING
    assert condition.what == f"no frame at all for 7 s although {bench.settings.channel} is up"
    assert condition.advice == "check CANH/CANL wiring, bit rate and that the controller is switched on"
    let_pass(bench, clock, 0.1, 0x310)
    assert bench.link.condition == OK
    bench.link.close()


def test_frames_but_not_the_wanted_ones() -> None:
    clock = VirtualClock()
    bench = opened(clock, FrameId(0x310), FrameId(0x18FF00F7, True))
    let_pass(bench, clock, 6.0, *range(0x20, 0x2C))
    condition = bench.link.condition
    assert condition.word is Wellness.WAITING
    assert "none with the wanted identifier 0x310, 0x18FF00F7 for 6 s" in condition.what
    assert "identifiers seen: 0x020, 0x021, 0x022, 0x023, 0x024, 0x025, 0x026, 0x027;" in condition.advice
    assert "`arbitration_id`" in condition.advice
    let_pass(bench, clock, 6.0)
    assert bench.link.condition.what.startswith("no frame at all")
    let_pass(bench, clock, 6.0, 0x20, 0x310)
    assert bench.link.condition == OK
    bench.link.close()


def test_frames_of_before_a_cable_break_are_not_taken_for_unwanted_ones() -> None:
    clock = VirtualClock()
    bench = opened(clock, FrameId(0x310))
    let_pass(bench, clock, 5.0, 0x310)
    said = []
    for _ in range(80):
        let_pass(bench, clock, 0.1)
        said.append(bench.link.condition.what.partition(" for ")[0])
    assert set(said) == {"", "no frame at all"}
    assert said.index("no frame at all") in (49, 50)  # 5 s after the last frame, not after a later look at the count
    bench.link.close()


def test_link_that_takes_everything_misses_nothing_in_particular() -> None:
    clock = VirtualClock()
    bench = Bench(clock=clock)
    bench.link.drain()
    let_pass(bench, clock, 10.0, 0x20)
    assert bench.link.condition == OK
    let_pass(bench, clock, 10.0)
    assert bench.link.condition.what.startswith("no frame at all")
    bench.link.close()


def test_link_from_which_nothing_is_wanted_waits_for_nothing() -> None:
    clock = VirtualClock()
    bench = Bench(clock=clock, ids=[])
    bench.link.drain()
    let_pass(bench, clock, 10.0)
    assert bench.link.condition == OK
    bench.link.close()


@pytest.mark.parametrize(("timeout_ms", "silent_after_s"), [(1000.0, 5), (20_000.0, 20)])
def test_slow_source_is_given_its_time(timeout_ms: float, silent_after_s: int) -> None:
    clock = VirtualClock()
    channel = unused_channel()
    settings = CanSettings(
        interface="virtual", channel=channel, displacement=DisplacementSettings(timeout_ms=timeout_ms)
    )
    link = CanBus(settings, nobody, clock, [FrameId(0x310)])
    link.drain()
    silent = []
    for second in range(1, 30):
        clock.sleep(1.0)
        link.drain()
        if link.condition.what:
            silent.append(second)
    assert silent[0] == silent_after_s
    link.close()


def test_silence_before_a_reopening_does_not_count() -> None:
    clock = VirtualClock()
    bench = opened(clock, FrameId(0x310))
    let_pass(bench, clock, 6.0, 0x20)
    bench.network.is_up = False
    let_pass(bench, clock, 6.0)
    assert "is down" in bench.link.condition.what
    bench.network.is_up = True
    let_pass(bench, clock, 5.0)
    assert bench.link.condition == OK
    let_pass(bench, clock, 5.0)
    assert bench.link.condition.what.startswith("no frame at all")
    with NetworkBus(bench.settings.channel) as peer:
        peer.send(message(0x310))
    bench.link.drain()
    assert bench.link.condition == OK
    bench.link.close()
