"""The virtual support joined to the program: simulated stream, transmitter, interface faults."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from typing import Any

import pytest

from daemon.recording import topics
from daemon.recording.topics import Recorded
from daemon.settings import Settings
from daemon.simulation.demo import demo_settings
from daemon.simulation.run import SimulatedRun
from daemon.simulation.stream import SimulatedStream
from daemon.simulation.virtual import ControllerTransmitter, virtual_controller, virtual_support
from drivers.can.frame import Frame
from drivers.can.interface import open_bus
from drivers.can.settings import CanConfigError
from drivers.clock import VirtualClock
from drivers.virtual.can_network import network
from drivers.virtual.faults import FaultScript
from drivers.virtual.faulty_controller import FaultyController
from drivers.virtual.support import VirtualSupport
from estimation.records import Tick
from tests.drivers.fault_kit import fault, script

START_NS = 3_000_000_000


def settings(channel: str, **can: Any) -> Settings:
    tree = demo_settings(5).model_dump()
    tree["can"] |= {"channel": channel} | can
    return Settings.model_validate(tree)


def stream(
    faults: FaultScript | None, channel: str, **can: Any
) -> tuple[SimulatedStream, list[tuple[str, Recorded]], VirtualClock]:
    clock = VirtualClock(START_NS)
    support = VirtualSupport(5, start_ns=START_NS, cycles=1)
    taken: list[tuple[str, Recorded]] = []
    chosen = settings(channel, **can)
    run = SimulatedRun.of(chosen, support, clock, faults)
    simulated = SimulatedStream(chosen, run, clock, lambda topic, record: taken.append((topic, record)))
    return simulated, taken, clock


def go(simulated: SimulatedStream, clock: VirtualClock, until_s: float) -> None:
    while clock.now_ns() < START_NS + until_s * 1e9:
        before_ns = clock.now_ns()
        assert all(simulated.step() for _ in range(5))
        assert clock.now_ns() > before_ns, "no time passes"


def ticks(taken: list[tuple[str, Recorded]]) -> list[float]:
    return [(record.t_ns - START_NS) / 1e9 for _, record in taken if isinstance(record, Tick)]


def test_time_passes_in_the_estimator_while_the_sensor_is_silent_and_only_then() -> None:
    simulated, taken, clock = stream(script(fault("unplugged", 3.0, 2.0)), "stream-a")
    with simulated:
        go(simulated, clock, 7.0)
    times = ticks(taken)
    assert 3.25 < times[0] < 3.6
    assert 5.2 < times[-1] < 7.0
    gaps = [late - early for early, late in pairwise(times)]
    assert all(0.099 < gap < 0.3 for gap in gaps)
    estimates = [record for topic, record in taken if topic == topics.PROVISIONAL]
    assert estimates


def test_a_sensor_that_is_dead_from_the_beginning_gets_its_ten_seconds() -> None:
    simulated, taken, clock = stream(script(fault("unplugged", 0.0, 1000.0)), "stream-b")
    with simulated:
        go(simulated, clock, 12.0)
        assert simulated.run.identity is None
    assert 9.9 < ticks(taken)[0] < 10.3
    assert any(topic == topics.OBSERVED for topic, _ in taken)


def test_a_run_whose_sensor_is_dead_for_good_ends_with_the_motion() -> None:
    simulated, taken, clock = stream(script(fault("miso_low", 1.0, 1000.0)), "stream-c", enabled=False)
    heard: list[int] = []
    with simulated:
        simulated.play(heard.append)
    assert heard == sorted(heard)
    assert clock.now_ns() > START_NS + 30e9
    assert ticks(taken)[-1] > 30


def test_a_replaced_sensor_is_met_as_another_one() -> None:
    simulated, taken, clock = stream(script(fault("replaced", 2.0, 0.5, serial=99)), "stream-d")
    with simulated:
        go(simulated, clock, 5.0)
    serials = [getattr(record, "serial", None) for topic, record in taken if topic == topics.IMU_IDENTITY]
    assert (serials[0], serials[-1]) == (1234, 99)


def test_an_interface_that_goes_away_costs_the_frames_of_that_time_and_no_more() -> None:
    faults = script(fault("interface_down", 2.0, 1.0), fault("interface_deleted", 4.0, 1.0))
    chosen, clock = settings("transmitter-a"), VirtualClock(START_NS)
    support = VirtualSupport(5, start_ns=START_NS, cycles=1)
    sender = ControllerTransmitter(chosen, virtual_controller(chosen, support, faults), clock)
    while clock.now_ns() < START_NS + 7e9:
        clock.sleep(0.01)
        sender.send_due()
    whole = virtual_controller(chosen, VirtualSupport(5, start_ns=START_NS, cycles=1))
    due = whole.due(clock.now_ns())
    gone = [f for f in due if 2.0 <= (f.t_ns - START_NS) / 1e9 < 3.0 or 4.0 <= (f.t_ns - START_NS) / 1e9 < 5.0]
    assert sender.sent + sender.failed == len(due)
    assert sender.failed == len(gone)
    assert sender.sent_by_kind.total() == sender.sent
    assert set(sender.sent_by_kind) == {"0x310", "0x311"}
    clock.advance_to(START_NS + 2_000_000_000)
    sender.close()
    assert network("transmitter-a").is_up


def test_a_sender_closed_while_the_interface_is_away_puts_it_back() -> None:
    faults = script(fault("interface_deleted", 0.0, 100.0))
    chosen, clock = settings("transmitter-b"), VirtualClock(START_NS)
    support = VirtualSupport(5, start_ns=START_NS, cycles=1)
    sender = ControllerTransmitter(chosen, virtual_controller(chosen, support, faults), clock)
    clock.sleep(1.0)
    sender.send_due()
    assert (network("transmitter-b").exists, sender.sent) == (False, 0)
    assert sender.failed > 10
    sender.close()
    assert network("transmitter-b").exists


def test_error_frames_go_out_as_such_and_are_counted_apart() -> None:
    faults = script(fault("bus_off", 1.0, 1.0))
    chosen, clock = settings("transmitter-c"), VirtualClock(START_NS)
    support = VirtualSupport(5, start_ns=START_NS, cycles=1)
    sender = ControllerTransmitter(chosen, virtual_controller(chosen, support, faults), clock)
    listener = open_bus(chosen.can, None)
    clock.sleep(3.0)
    sender.send_due()
    heard = []
    while (message := listener.recv(0)) is not None:
        heard.append(message)
    listener.shutdown()
    sender.close()
    assert [m.arbitration_id for m in heard if m.is_error_frame] == [0x040, 0x100]
    assert sender.sent_by_kind["error frame"] == 2
    assert sender.sent == len(heard)


def test_a_sender_in_real_time_ends_with_its_frames() -> None:
    class Few:
        """Three frames, long due."""

        def __init__(self) -> None:
            self.frames = [Frame(t, 0x10, b"") for t in (1, 2, 3)]

        @property
        def next_t_ns(self) -> int | None:
            return self.frames[0].t_ns if self.frames else None

        def due(self, t_ns: int) -> list[Frame]:
            return [self.frames.pop(0)]

    sender = ControllerTransmitter(settings("transmitter-d"), Few(), VirtualClock(START_NS))
    asyncio.run(sender.run())
    assert (sender.sent, sender.failed) == (3, 0)


@pytest.mark.parametrize(
    "interface",
    [{"interface": "socketcan", "channel": "vcan0"}, {"interface": "udp_multicast", "channel": "239.74.163.2"}],
)
def test_a_real_interface_is_not_taken_away(interface: dict[str, str]) -> None:
    tree = demo_settings(1).model_dump()
    tree["can"] |= interface
    chosen = Settings.model_validate(tree)
    support = virtual_support(chosen, cycles=0)
    with pytest.raises(
        CanConfigError, match=r"has interface_deleted, which only can\.interface = \"virtual\" can play"
    ):
        virtual_controller(chosen, support, script(fault("interface_deleted", 1.0, 1.0)))
    assert isinstance(virtual_controller(chosen, support, script(fault("can_silence", 1.0, 1.0))), FaultyController)
