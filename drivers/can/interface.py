"""Opening a python-can bus, asking how its interface is, and the way between its messages and our frames."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import struct
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can

from drivers.can.frame import Frame, FrameId
from drivers.can.settings import LARGEST_EXTENDED_ID, LARGEST_STANDARD_ID, CanSettings
from drivers.virtual.can_network import NetworkBus, network

# linux/sockios.h, linux/if.h
_SIOCGIFFLAGS = 0x8913
_IFF_UP = 0x1
_IFF_RUNNING = 0x40
_IFREQ = struct.Struct("16sh22x")

# asm-generic/socket.h, linux/sock_diag.h. The other way to the kernel's losses, SO_RXQ_OVFL, adds control data
# to each frame that python-can takes for a fault.
_SO_MEMINFO = 55
_MEMINFO = struct.Struct("=9I")
_MEMINFO_DROPS = 8

_NETWORK = "/sys/class/net"


class InterfaceFault(OSError):
    """A network interface cannot be used; `what` says why and `advice` what to do."""

    def __init__(self, number: int, what: str, advice: str) -> None:
        super().__init__(number, f"{what}: {advice}")
        self.what = what
        self.advice = advice


@dataclass(slots=True, frozen=True)
class InterfaceStatus:
    """An interface that is there and up."""

    index: int = 0  # another number means: deleted and made anew under the same name
    is_running: bool = True  # False: the kernel has switched its carrier off, which CAN drivers do when bus-off
    received: int | None = None  # frames since it is there, also those that a kernel filter holds back
    receives_own: bool = False  # whether what is sent on it counts there, too, as on a vcan interface


def open_bus(settings: CanSettings, ids: Collection[FrameId] | None) -> can.BusABC:
    """Open the interface; SocketCAN lets only `ids` through (None = all) and every error frame.

    Raises:
        InterfaceFault: it is missing or down.
        OSError: the bus cannot be opened.
        can.CanError: the bus cannot be opened.
    """
    # A missing interface would leave a log line at every try, and one that is down opens but stays mute.
    interface_status(settings)
    if settings.interface == "virtual":
        return NetworkBus(settings.channel, is_own=True)
    options: dict[str, Any] = {}
    if settings.interface == "socketcan":
        options = {"fd": True, "can_filters": None if ids is None else [_kernel_filter(id_) for id_ in ids]}
    else:
        # Hop limit 0: frames sent in a trial do not leave this computer. No filters: python-can would apply
        # them after reading, and its `recv(0)` then says "nothing there" for a frame that it dropped.
        options = {"port": settings.port, "hop_limit": 0}
    return can.Bus(interface=settings.interface, channel=settings.channel, ignore_config=True, **options)


def interface_status(settings: CanSettings) -> InterfaceStatus:
    """How the interface is; there is nothing to ask about a multicast group.

    Raises:
        InterfaceFault: it is missing (ENODEV) or down (ENETDOWN).
    """
    if settings.interface == "socketcan":
        return _kernel_status(settings.channel)
    if settings.interface == "virtual":
        shared = network(settings.channel)
        if not shared.exists:
            raise _missing(errno.ENODEV, settings.channel)
        if not shared.is_up:
            raise _down(settings.channel)
        return InterfaceStatus(shared.index, not shared.is_bus_off, shared.received)
    return InterfaceStatus()


def kernel_drops(bus: can.BusABC) -> int:
    """Frames that found the bus's receive buffer full since it was opened.

    Raises:
        OSError: the bus is no socket any more.
    """
    if isinstance(bus, NetworkBus):
        return bus.lost
    # The family does not matter for this question; a duplicate, so that closing it leaves the bus open.
    with socket.fromfd(bus.fileno(), socket.AF_UNIX, socket.SOCK_DGRAM) as same_socket:
        answer = same_socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
    drops: int = _MEMINFO.unpack(answer)[_MEMINFO_DROPS]
    return drops


def never_sent(settings: CanSettings) -> int:
    """Frames that were handed to the interface and that the kernel dropped, as it does in listen-only mode."""
    return (_statistic(settings.channel, "tx_dropped") or 0) if settings.interface == "socketcan" else 0


def _kernel_status(name: str) -> InterfaceStatus:
    # A Unix socket will do for the question and passes a service's RestrictAddressFamilies=.
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as any_socket:
        try:
            answer = fcntl.ioctl(any_socket, _SIOCGIFFLAGS, _IFREQ.pack(os.fsencode(name)[:15], 0))
            index = socket.if_nametoindex(name)
        except OSError as error:
            raise _missing(error.errno or errno.ENODEV, name) from error
    flags = _IFREQ.unpack(answer)[1]
    has_controller = Path(_NETWORK, name, "device").exists()
    if not flags & _IFF_UP:
        rate = f"; the first time: ip link set {name} up type can bitrate 250000, with the bit rate of your bus"
        raise _down(name, rate if has_controller else "")
    # Without a controller, what an interface receives is what programs send on it.
    received = _statistic(name, "rx_packets")
    return InterfaceStatus(index, bool(flags & _IFF_RUNNING), received, receives_own=not has_controller)


def _statistic(name: str, what: str) -> int | None:
    try:
        return int(Path(_NETWORK, name, "statistics", what).read_text())
    except (OSError, ValueError):  # a container without /sys
        return None


def _missing(number: int, name: str) -> InterfaceFault:
    return InterfaceFault(number, f"there is no network interface {name}", "plug it in, create it or correct `channel`")


def _down(name: str, rate: str = "") -> InterfaceFault:
    return InterfaceFault(errno.ENETDOWN, f"network interface {name} is down", f"ip link set {name} up{rate}")


def to_frame(message: can.Message, t_ns: int) -> Frame:
    """Our frame from python-can's message."""
    return Frame(
        t_ns=t_ns,
        arbitration_id=message.arbitration_id,
        data=bytes(message.data),
        is_extended=message.is_extended_id,
        is_fd=message.is_fd,
        is_error=message.is_error_frame,
        is_remote=message.is_remote_frame,
    )


def to_message(frame: Frame) -> can.Message:
    """python-can's message from our frame.

    Raises:
        ValueError: identifier or length do not exist on CAN.
    """
    return can.Message(
        arbitration_id=frame.arbitration_id,
        data=frame.data,
        is_extended_id=frame.is_extended,
        is_fd=frame.is_fd,
        is_error_frame=frame.is_error,
        is_remote_frame=frame.is_remote,
        check=True,
    )


def _kernel_filter(frame_id: FrameId) -> can.typechecking.CanFilter:
    mask = LARGEST_EXTENDED_ID if frame_id.is_extended else LARGEST_STANDARD_ID
    return {"can_id": frame_id.arbitration_id, "can_mask": mask, "extended": frame_id.is_extended}
