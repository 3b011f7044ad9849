"""The network within one process behaves as python-can on a vcan interface of Linux does."""

from __future__ import annotations

import errno
import select
from typing import Any

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.interface import InterfaceFault, interface_status, open_bus
from drivers.can.settings import CanSettings
from drivers.virtual.can_network import CanNetwork, NetworkBus, error_message, network
from tests.drivers.can_bench import message, unused_channel


@pytest.fixture
def can0() -> CanNetwork:
    return network(unused_channel())


def test_interface_counts_the_data_frames_of_others_until_it_is_made_anew() -> None:
    settings_ = CanSettings(interface="virtual", channel=unused_channel(), listen_only=False)
    with open_bus(settings_, None) as own, NetworkBus(settings_.channel) as other:
        own.send(message(1))
        other.send(message(2))
        other.send(message(3))
        network(settings_.channel).deliver(error_message(0x08))
        assert interface_status(settings_).received == 2
        network(settings_.channel).exists = False
        network(settings_.channel).exists = True
        assert interface_status(settings_).received == 0


def received(bus: NetworkBus) -> list[can.Message]:
    return list(iter(lambda: bus.recv(0), None))


def receive_error(bus: NetworkBus) -> int | None:
    with pytest.raises(can.CanOperationError) as raised:
        bus.recv(0)
    return raised.value.error_code


def send_error(bus: NetworkBus) -> int | None:
    with pytest.raises(can.CanOperationError) as raised:
        bus.send(message(1))
    return raised.value.error_code


def is_readable(bus: NetworkBus) -> bool:
    return bool(select.select([bus], [], [], 0)[0])


def test_all_hear_what_one_sends_except_itself(can0: CanNetwork) -> None:
    buses = [NetworkBus(can0.channel) for _ in range(3)]
    stranger = NetworkBus(unused_channel())
    assert not any(map(is_readable, buses))
    buses[0].send(message(7))
    assert [is_readable(bus) for bus in buses] == [False, True, True]
    assert [[heard.arbitration_id for heard in received(bus)] for bus in buses] == [[], [7], [7]]
    assert received(stranger) == []
    for bus in (*buses, stranger):
        bus.shutdown()


PAYLOADS = st.one_of(
    st.binary(max_size=8).map(lambda data: {"data": data}),
    st.sampled_from([12, 16, 20, 24, 32, 48, 64])
    .flatmap(lambda size: st.binary(min_size=size, max_size=size))
    .flatmap(
        lambda data: st.fixed_dictionaries(
            {"data": st.just(data), "is_fd": st.just(True), "bitrate_switch": st.booleans()}
            | {"error_state_indicator": st.booleans()}
        )
    ),
    st.integers(0, 8).map(lambda length: {"is_remote_frame": True, "dlc": length}),
)


@given(identifier=st.integers(0, 0x1FFFFFFF), payload=PAYLOADS)
@settings(derandomize=True, deadline=None, max_examples=60)
def test_every_frame_arrives_as_it_was_sent(identifier: int, payload: dict[str, Any]) -> None:
    with NetworkBus("same") as near, NetworkBus("same") as far:
        sent = can.Message(arbitration_id=identifier, is_extended_id=identifier > 0x7FF, check=True, **payload)
        near.send(sent)
        (heard,) = received(far)
        assert heard.equals(sent, timestamp_delta=None, check_direction=False, check_channel=False)


def test_error_frames_reach_every_bus(can0: CanNetwork) -> None:
    with NetworkBus(can0.channel) as near, NetworkBus(can0.channel) as far:
        can0.deliver(error_message(0x04, b"\0\x10\0\0\0\0\0\0"))
        for bus in (near, far):
            (heard,) = received(bus)
            assert (heard.is_error_frame, heard.arbitration_id, heard.data[1]) == (True, 0x04, 0x10)


def test_what_does_not_fit_is_lost_and_counted(can0: CanNetwork) -> None:
    with NetworkBus(can0.channel) as near, NetworkBus(can0.channel) as far:
        for number in range(2000):
            near.send(message(number % 0x800))
        heard = received(far)
        assert far.lost > 0
        assert len(heard) + far.lost == 2000
        assert len(heard) >= 100  # a burst finds room
        assert [one.arbitration_id for one in heard] == list(range(len(heard)))
        near.send(message(1))  # there is room again
        assert len(received(far)) == 1


def test_waiting_for_a_frame_ends_when_one_comes_or_time_is_up(can0: CanNetwork) -> None:
    with NetworkBus(can0.channel) as near, NetworkBus(can0.channel) as far:
        assert far.recv(0.01) is None
        near.send(message(1))
        assert far.recv(None) is not None


def test_reader_of_an_interface_put_down_is_told_once_and_the_same_bus_works_on(can0: CanNetwork) -> None:
    with NetworkBus(can0.channel) as near, NetworkBus(can0.channel) as far:
        near.send(message(1))
        can0.is_up = False
        assert is_readable(far)
        assert receive_error(far) == errno.ENETDOWN == 100
        assert [heard.arbitration_id for heard in received(far)] == [1]  # what had arrived before
        assert far.recv(0) is None
        assert not is_readable(far)
        assert send_error(far) == errno.ENETDOWN
        can0.is_up = True
        assert receive_error(near) == errno.ENETDOWN
        near.send(message(2))
        far.send(message(3))
        assert [received(far)[0].arbitration_id, received(near)[0].arbitration_id] == [2, 3]


def test_opening_while_down_succeeds_and_open_bus_refuses_it_in_words(can0: CanNetwork) -> None:
    can0.is_up = False
    with NetworkBus(can0.channel) as bus:
        assert bus.recv(0) is None
    with pytest.raises(InterfaceFault, match=f"{can0.channel} is down: ip link set {can0.channel} up") as refusal:
        open_bus(CanSettings(interface="virtual", channel=can0.channel), None)
    assert refusal.value.errno == errno.ENETDOWN


def test_missing_interface_cannot_be_opened(can0: CanNetwork) -> None:
    can0.exists = False
    with pytest.raises(OSError, match="No such device") as refusal:
        NetworkBus(can0.channel)
    assert refusal.value.errno == errno.ENODEV == 19
    with pytest.raises(InterfaceFault, match=f"there is no network interface {can0.channel}: plug it in") as refused:
        open_bus(CanSettings(interface="virtual", channel=can0.channel), None)
    assert refused.value.errno == errno.ENODEV


@pytest.mark.parametrize(("up", "errors"), [(True, [100, 19]), (False, [19])])
def test_deleted_interface_leaves_a_bus_that_is_dead_for_ever(can0: CanNetwork, up: bool, errors: list[int]) -> None:
    with NetworkBus(can0.channel) as old:
        if not up:
            can0.is_up = False
            assert receive_error(old) == errno.ENETDOWN
        can0.exists = False
        assert [receive_error(old) for _ in errors] == errors
        assert old.recv(0) is None
        assert send_error(old) == errno.ENXIO == 6
        before = can0.index
        can0.exists = True
        assert can0.index != before
        assert can0.is_up
        assert send_error(old) == errno.ENXIO
        with NetworkBus(can0.channel) as new, NetworkBus(can0.channel) as peer:
            peer.send(message(1))
            assert (len(received(new)), len(received(old))) == (1, 0)


def test_full_receive_buffer_does_not_hide_that_the_interface_went_down(can0: CanNetwork) -> None:
    with NetworkBus(can0.channel) as near, NetworkBus(can0.channel) as far:
        while not far.lost:
            near.send(message(1))
        can0.is_up = False
        assert is_readable(far)
        assert receive_error(far) == errno.ENETDOWN


def test_bus_off_is_told_and_nothing_can_be_sent_until_the_restart(can0: CanNetwork) -> None:
    with NetworkBus(can0.channel) as near, NetworkBus(can0.channel) as far:
        can0.is_bus_off = True
        assert send_error(near) == errno.ENOBUFS
        can0.is_bus_off = False
        near.send(message(1))
        assert [(heard.is_error_frame, heard.arbitration_id) for heard in received(far)] == [
            (True, 0x40),
            (True, 0x100),
            (False, 1),
        ]


def test_closed_bus_neither_hears_nor_sends(can0: CanNetwork) -> None:
    near, far = NetworkBus(can0.channel), NetworkBus(can0.channel)
    far.shutdown()
    far.shutdown()
    near.send(message(1))
    assert send_error(far) == errno.EBADF
    near.shutdown()
