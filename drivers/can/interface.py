"""Opening a python-can bus, and the way between its messages and our frames."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import struct
from collections.abc import Collection
from typing import Any

import can

from drivers.can.frame import Frame, FrameId
from drivers.can.settings import LARGEST_EXTENDED_ID, LARGEST_STANDARD_ID, CanSettings

# linux/sockios.h, linux/if.h
_SIOCGIFFLAGS = 0x8913
_IFF_UP = 0x1
_IFREQ = struct.Struct("16sh22x")


def open_bus(settings: CanSettings, ids: Collection[FrameId] | None) -> can.BusABC:
    """Open the interface; SocketCAN lets only `ids` through (None = all) and every error frame.

    Raises:
        OSError: a SocketCAN interface is missing or down.
        can.CanError: the bus cannot be opened.
    """
    options: dict[str, Any] = {}
    if settings.interface == "socketcan":
        # A missing interface would leave a log line at every try, and one that is down opens but stays mute.
        require_interface_up(settings.channel)
        options = {"fd": True, "can_filters": None if ids is None else [_kernel_filter(id_) for id_ in ids]}
    elif settings.interface == "udp_multicast":
        # Hop limit 0: frames sent in a trial do not leave this computer.
        options = {"port": settings.port, "hop_limit": 0}
    # No filters for the others: python-can would apply them after reading, and its `recv(0)` then says
    # "nothing there" for a frame that it dropped.
    return can.Bus(interface=settings.interface, channel=settings.channel, ignore_config=True, **options)


def require_interface_up(name: str) -> None:
    """Check a network interface.

    Raises:
        OSError: it is missing (ENODEV) or down (ENETDOWN), with a text that says what to do.
    """
    # A Unix socket will do for the question and passes a service's RestrictAddressFamilies=.
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as any_socket:
        try:
            answer = fcntl.ioctl(any_socket, _SIOCGIFFLAGS, _IFREQ.pack(os.fsencode(name)[:15], 0))
        except OSError as error:
            raise OSError(
                error.errno,
                f"there is no network interface {name}: plug it in, create it or correct `channel`",
            ) from error
    if not _IFREQ.unpack(answer)[1] & _IFF_UP:
        raise OSError(errno.ENETDOWN, f"network interface {name} is down: ip link set {name} up")


def file_descriptor(bus: can.BusABC) -> int | None:
    """The bus's file descriptor, None for a bus without one (virtual)."""
    try:
        fd = bus.fileno()
    except NotImplementedError:
        return None
    return fd if fd >= 0 else None


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
