"""Every bit of linux/can/error.h in words, in counts, and in what it means for the link."""

from __future__ import annotations

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.error_frames import BUS_OFF, ERROR_ACTIVE, ERROR_PASSIVE, ERROR_WARNING, decode
from drivers.can.error_tally import ErrorTally
from drivers.can.frame import Frame
from drivers.clock import VirtualClock
from drivers.condition import Wellness
from drivers.virtual.can_network import error_message
from tests.drivers.can_bench import Bench, message

EVERY_BIT = [
    # class, detail bytes by index, words
    (0x001, {}, "transmit timeout"),
    (0x002, {}, "arbitration lost"),
    (0x002, {0: 5}, "arbitration lost in bit 5"),
    (0x002, {0: 255}, "arbitration lost in bit 255"),
    (0x004, {}, "controller problem"),
    (0x004, {1: 0x01}, "receive buffer overflow"),
    (0x004, {1: 0x02}, "transmit buffer overflow"),
    (0x004, {1: 0x04}, "error-warning (receive)"),
    (0x004, {1: 0x08}, "error-warning (transmit)"),
    (0x004, {1: 0x10}, "error-passive (receive)"),
    (0x004, {1: 0x20}, "error-passive (transmit)"),
    (0x004, {1: 0x40}, "error-active again"),
    (0x004, {1: 0x80}, "controller problem 0x80"),
    (0x004, {1: 0x21}, "receive buffer overflow, error-passive (transmit)"),
    (0x008, {}, "protocol violation"),
    (0x008, {2: 0x01}, "bit error"),
    (0x008, {2: 0x02}, "form error"),
    (0x008, {2: 0x04}, "stuff error"),
    (0x008, {2: 0x08}, "bit error (cannot send dominant)"),
    (0x008, {2: 0x10}, "bit error (cannot send recessive)"),
    (0x008, {2: 0x20}, "bus overload"),
    (0x008, {2: 0x40}, "active error flag"),
    (0x008, {2: 0x80}, "protocol violation while sending"),
    (0x008, {2: 0x84, 3: 0x0A}, "stuff error at data field while sending"),
    (0x008, {2: 0x02, 3: 0x03}, "form error at start of frame"),
    (0x008, {2: 0x02, 3: 0x02}, "form error at identifier bits 28-21"),
    (0x008, {2: 0x02, 3: 0x06}, "form error at identifier bits 20-18"),
    (0x008, {2: 0x02, 3: 0x04}, "form error at substitute RTR bit"),
    (0x008, {2: 0x02, 3: 0x05}, "form error at identifier extension bit"),
    (0x008, {2: 0x02, 3: 0x07}, "form error at identifier bits 17-13"),
    (0x008, {2: 0x02, 3: 0x0F}, "form error at identifier bits 12-5"),
    (0x008, {2: 0x02, 3: 0x0E}, "form error at identifier bits 4-0"),
    (0x008, {2: 0x02, 3: 0x0C}, "form error at RTR bit"),
    (0x008, {2: 0x02, 3: 0x0D}, "form error at reserved bit 1"),
    (0x008, {2: 0x02, 3: 0x09}, "form error at reserved bit 0"),
    (0x008, {2: 0x02, 3: 0x0B}, "form error at data length code"),
    (0x008, {2: 0x02, 3: 0x08}, "form error at CRC sequence"),
    (0x008, {2: 0x02, 3: 0x18}, "form error at CRC delimiter"),
    (0x008, {2: 0x02, 3: 0x19}, "form error at acknowledge slot"),
    (0x008, {2: 0x02, 3: 0x1B}, "form error at acknowledge delimiter"),
    (0x008, {2: 0x02, 3: 0x1A}, "form error at end of frame"),
    (0x008, {2: 0x02, 3: 0x12}, "form error at intermission"),
    (0x008, {2: 0x02, 3: 0x77}, "form error at place 0x77"),
    # c_can and m_can tell these two by the place alone.
    (0x088, {3: 0x08}, "bus error, CRC error"),
    (0x088, {2: 0x80, 3: 0x19}, "bus error, no acknowledgement while sending"),
    (0x010, {}, "transceiver problem"),
    (0x010, {4: 0x04}, "CANH not connected"),
    (0x010, {4: 0x05}, "CANH shorted to the battery"),
    (0x010, {4: 0x06}, "CANH shorted to the supply"),
    (0x010, {4: 0x07}, "CANH shorted to ground"),
    (0x010, {4: 0x40}, "CANL not connected"),
    (0x010, {4: 0x50}, "CANL shorted to the battery"),
    (0x010, {4: 0x60}, "CANL shorted to the supply"),
    (0x010, {4: 0x70}, "CANL shorted to ground"),
    (0x010, {4: 0x80}, "CANL shorted to CANH"),
    (0x010, {4: 0x47}, "CANH shorted to ground, CANL not connected"),
    (0x010, {4: 0x01}, "transceiver problem 0x01"),
    (0x020, {}, "no acknowledgement"),
    (0x028, {3: 0x19}, "no acknowledgement"),  # said twice, counted once
    (0x040, {}, "bus-off"),
    (0x080, {}, "bus error"),
    (0x100, {}, "restarted"),
    (0x200, {6: 12, 7: 34}, "error counters (transmit 12, receive 34)"),
    (0x400, {}, "unknown error class 0x400"),
    (0x000, {}, "unspecified error"),
]


def error_frame(error_class: int, details: dict[int, int], t_ns: int = 0) -> Frame:
    data = bytearray(8)
    for index, value in details.items():
        data[index] = value
    return Frame(t_ns, error_class, bytes(data), is_error=True)


@pytest.mark.parametrize(("error_class", "details", "words"), EVERY_BIT)
def test_error_frame_in_words(error_class: int, details: dict[int, int], words: str) -> None:
    assert str(decode(error_frame(error_class, details))) == words


@pytest.mark.parametrize(
    ("error_class", "status", "state"),
    [
        (0x040, 0x00, BUS_OFF),
        (0x044, 0x40, BUS_OFF),
        (0x100, 0x00, ERROR_ACTIVE),
        (0x004, 0x00, None),
        (0x004, 0x03, None),
        (0x004, 0x04, ERROR_WARNING),
        (0x004, 0x08, ERROR_WARNING),
        (0x004, 0x10, ERROR_PASSIVE),
        (0x004, 0x24, ERROR_PASSIVE),
        (0x004, 0x40, ERROR_ACTIVE),
        (0x008, 0x10, None),
    ],
)
def test_state_of_the_controller(error_class: int, status: int, state: str | None) -> None:
    assert decode(error_frame(error_class, {1: status})).state == state


def test_error_counters_are_read_only_if_the_frame_says_that_it_carries_them() -> None:
    with_counters = decode(error_frame(0x204, {1: 0x08, 6: 97, 7: 1}))
    assert (with_counters.transmit_errors, with_counters.receive_errors) == (97, 1)
    assert str(with_counters) == "error-warning (transmit)"
    without = decode(error_frame(0x004, {1: 0x08, 6: 97, 7: 1}))
    assert (without.transmit_errors, without.receive_errors) == (None, None)


@given(error_class=st.integers(0, 0x1FFFFFFF), data=st.binary(max_size=64))
@settings(derandomize=True, deadline=None, max_examples=300)
def test_any_error_frame_gives_words_and_a_bounded_set_of_kinds(error_class: int, data: bytes) -> None:
    report = decode(Frame(0, error_class, data, is_error=True))
    assert report.words
    assert all(word.kind for word in report.words)
    assert len({word.kind for word in report.words}) == len(report.words)
    assert str(report)
    assert not any(word.kind[-1].isdigit() for word in report.words)  # numbers belong to the detail


def test_tally_counts_by_kind_and_remembers_the_last() -> None:
    tally = ErrorTally()
    for bit in range(1, 256):
        tally.add(error_frame(0x002, {0: bit}, t_ns=bit * 1_000_000))
    tally.add(error_frame(0x204, {1: 0x10, 6: 3, 7: 128}, t_ns=300_000_000))
    tally.add(error_frame(0x020, {}, t_ns=2_000_000_000))
    assert tally.kinds == {"arbitration lost": 255, "error-passive (receive)": 1, "no acknowledgement": 1}
    assert (tally.state, tally.transmit_errors, tally.receive_errors) == (ERROR_PASSIVE, 3, 128)
    assert (tally.last, tally.last_ns) == ("no acknowledgement", 2_000_000_000)
    assert tally.in_last_second(2_000_000_000) == 1


# --- what the link makes of them ------------------------------------------------------------------------------


def error(error_class: int, **details: int) -> can.Message:
    frame = error_frame(error_class, {int(name[1:]): value for name, value in details.items()})
    return error_message(error_class, frame.data)


NO_ACK = error(0x020)
PASSIVE = error(0x204, d1=0x20, d6=128, d7=2)


@pytest.mark.parametrize(
    ("sequence", "state", "what", "advice"),
    [
        ([error(0x04, d1=0x08)], ERROR_WARNING, "is in error-warning", "120 ohm"),
        ([PASSIVE], ERROR_PASSIVE, "is error-passive: close to bus-off (error counters: transmit 128", "bit rate"),
        ([error(0x04, d1=0x10), error(0x04, d1=0x40)], ERROR_ACTIVE, "", ""),
        ([error(0x04, d1=0x10), error(0x08)], ERROR_PASSIVE, "error-passive", "CANH"),
        ([error(0x04, d1=0x10), error(0x04, d1=0x01)], ERROR_PASSIVE, "error-passive", "CANH"),
        ([error(0x40)], BUS_OFF, "is bus-off", "restart-ms"),
        ([PASSIVE, NO_ACK, error(0x40)], BUS_OFF, "is bus-off", "short circuit"),
        ([error(0x40), error(0x100)], ERROR_ACTIVE, "went bus-off once in the last 10 s", "short circuit"),
        ([error(0x40), error(0x100)] * 2, ERROR_ACTIVE, "went bus-off 2 times in the last 10 s", "short circuit"),
        ([error(0x40), message(1)], ERROR_ACTIVE, "and came back", "wrong bit rate"),  # nothing arrives while bus-off
        ([NO_ACK], ERROR_ACTIVE, "no acknowledgement", "alone on the bus"),
        ([PASSIVE, NO_ACK], ERROR_PASSIVE, "no acknowledgement", "listen-only"),
        ([NO_ACK, message(1)], ERROR_ACTIVE, "", ""),  # who sends would acknowledge as well
        ([error(0x88, d2=0x04)] * 9, ERROR_ACTIVE, "", ""),
        ([error(0x88, d2=0x04)] * 10, ERROR_ACTIVE, "10 error frames", "bit rate"),
    ],
)
def test_condition_of_the_link(sequence: list[can.Message], state: str, what: str, advice: str) -> None:
    clock = VirtualClock(7_000_000_000)
    bench = Bench(clock=clock)
    bench.link.drain()
    for item in sequence:
        bench.network.deliver(item)
        clock.sleep(0.001)
        bench.link.drain()
    condition = bench.link.condition
    assert bench.link.controller_state == state
    assert (what in condition.what, advice in condition.advice) == (True, True)
    assert (condition.what == "") == (what == "")
    assert (condition.word is Wellness.WAITING) == (state == BUS_OFF)
    assert bench.link.counters.error_frames == sum(item.is_error_frame for item in sequence)
    bench.link.close()


def test_bus_that_is_opened_anew_forgets_what_was_said_of_the_controller() -> None:
    clock = VirtualClock()
    bench = Bench(clock=clock)
    bench.link.drain()
    bench.network.deliver(PASSIVE)
    bench.link.drain()
    bench.network.is_up = False
    bench.link.drain()
    bench.network.is_up = True
    clock.sleep(0.1)
    bench.link.drain()
    assert (bench.link.controller_state, bench.link.condition.what) == (ERROR_ACTIVE, "")
    assert bench.link.errors.kinds == {"error-passive (transmit)": 1}
    bench.link.close()


@pytest.mark.parametrize("trouble", [PASSIVE, error(0x04, d1=0x08)])
def test_controller_that_has_not_complained_for_ten_seconds_of_frames_is_error_active_again(
    trouble: can.Message,
) -> None:
    clock = VirtualClock()
    bench = Bench(clock=clock)
    bench.link.drain()
    bench.network.deliver(trouble)
    bench.link.drain()
    state = bench.link.controller_state
    clock.sleep(30.0)
    bench.link.drain()
    assert bench.link.controller_state == state  # silence proves nothing
    bench.network.deliver(error(0x08))
    for _ in range(99):
        bench.network.deliver(message(1))
        bench.link.drain()
        clock.sleep(0.1)
    assert bench.link.controller_state == state != ERROR_ACTIVE
    clock.sleep(0.1)
    bench.network.deliver(message(1))
    bench.link.drain()
    assert bench.link.controller_state == ERROR_ACTIVE
    bench.link.close()


@pytest.mark.parametrize(("told", "afterwards"), [(PASSIVE, ERROR_ACTIVE), (error(0x40), BUS_OFF)])
def test_state_is_forgotten_when_the_frame_that_ended_it_may_be_lost(told: can.Message, afterwards: str) -> None:
    clock = VirtualClock()
    bench = Bench(clock=clock)
    bench.link.drain()
    for _ in range(2000):
        bench.network.deliver(message(1))
    bench.link.drain()
    bench.network.deliver(told)
    bench.link.drain()
    assert bench.link.controller_state != ERROR_ACTIVE
    clock.sleep(1.0)
    bench.link.drain()
    assert bench.link.counters.kernel_drops > 0
    assert bench.link.controller_state == afterwards
    bench.link.close()


def test_report_names_the_errors() -> None:
    bench = Bench(clock=VirtualClock(3_500_000_000))
    bench.link.drain()
    bench.network.deliver(PASSIVE)
    bench.link.drain()
    report = bench.link.report()
    assert (report["controller"], report["transmit_errors"], report["receive_errors"]) == (ERROR_PASSIVE, 128, 2)
    assert (report["last_error_frame"], report["last_error_frame_s"]) == ("error-passive (transmit)", 3.5)
    assert report["error_frames_per_s"] == 1
    bench.link.close()
