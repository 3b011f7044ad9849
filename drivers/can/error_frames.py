"""The CAN controller's own state, read from the kernel's error frames (linux/can/error.h).

python-can's `SocketcanBus.state` always says active, so error frames are the only news without netlink.
"""

from __future__ import annotations

from drivers.can.frame import Frame

ERROR_ACTIVE = "error-active"
ERROR_WARNING = "error-warning"
ERROR_PASSIVE = "error-passive"
BUS_OFF = "bus-off"

_CLASS_CONTROLLER = 0x004
_CLASS_BUS_OFF = 0x040
_CLASS_RESTARTED = 0x100
_DATA_WARNING = 0x04 | 0x08  # receive, transmit
_DATA_PASSIVE = 0x10 | 0x20
_DATA_ACTIVE = 0x40


def controller_state(frame: Frame, previous: str) -> str:
    """State after error frame `frame`; `previous` if it says nothing about the state."""
    if frame.arbitration_id & _CLASS_BUS_OFF:
        return BUS_OFF
    if frame.arbitration_id & _CLASS_RESTARTED:
        return ERROR_ACTIVE
    if frame.arbitration_id & _CLASS_CONTROLLER and len(frame.data) > 1:
        detail = frame.data[1]
        if detail & _DATA_PASSIVE:
            return ERROR_PASSIVE
        if detail & _DATA_WARNING:
            return ERROR_WARNING
        if detail & _DATA_ACTIVE:
            return ERROR_ACTIVE
    return previous
