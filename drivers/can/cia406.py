"""What a CANopen linear encoder says about itself beside its position.

A CiA 406 sensor that lost its magnet may go on sending its last good position, so the position frame alone
proves nothing: the emergency object (EMCY, CiA 301) tells. A sensor that is silent may tell by its heartbeat why.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.can.cia301 import BOOT_UP
from drivers.can.frame import Frame, FrameId
from drivers.can.remembered import Count, TimeNs

DEFAULT_NODE = 127

_EMCY_BASE = 0x080
_TPDO1_BASE = 0x180
_HEARTBEAT_BASE = 0x700
_EMERGENCY_HEAD = struct.Struct("<HB")  # error code, error register
_COMMUNICATION_CLASSES = (0x81, 0x82)  # CAN overrun, missing heartbeat, PDO length ...: the position is sound
_GENERIC_BIT, _COMMUNICATION_BIT = 0x01, 0x10  # of the error register (object 1001h)
_GUARDING_TOGGLE = 0x80  # a node that is guarded instead of beating alternates this bit


def position_id(node: int) -> FrameId:
    """Identifier of the first transmit PDO of `node` (CiA 301 predefined connection set)."""
    return FrameId(_TPDO1_BASE + node)


def emergency_id(node: int) -> FrameId:
    """Identifier of the emergency object of `node`."""
    return FrameId(_EMCY_BASE + node)


def heartbeat_id(node: int) -> FrameId:
    """Identifier of the heartbeat and boot-up message of `node`."""
    return FrameId(_HEARTBEAT_BASE + node)


@dataclass(slots=True)
class NodeWatch:
    """Remembers whether a node has an emergency pending, and its state.

    An emergency ends when the node reports "no error" with an empty error register, or when it boots anew. One
    about communication speaks of the bus and not of the position, so it is kept apart.
    """

    error_code: Count | None = None  # CiA 301 emergency error code, None = no emergency
    communication_code: Count | None = None  # the same, of communication and protocol
    error_register: Count = 0
    state: Count | None = None  # of the last heartbeat or boot-up message
    heard_ns: TimeNs = 0  # when that came
    emergencies: Count = 0
    malformed_emergencies: Count = 0

    def observe(self, frame: Frame, node: int) -> None:
        """Take in a frame; one that is neither emergency nor heartbeat of `node` is ignored."""
        if frame.frame_id == emergency_id(node):
            self._observe_emergency(frame.data)
        elif frame.frame_id == heartbeat_id(node) and len(frame.data) == 1:
            self._observe_heartbeat(frame.data[0], frame.t_ns)

    def _observe_emergency(self, data: bytes) -> None:
        if len(data) < _EMERGENCY_HEAD.size:
            self.malformed_emergencies += 1
            return
        self.emergencies += 1
        code, self.error_register = _EMERGENCY_HEAD.unpack_from(data)
        if code >> 8 in _COMMUNICATION_CLASSES:
            self.communication_code = code
        elif code >> 8:
            self.error_code = code
        # Code 0x00xx says that one error went away; the register tells whether others remain.
        elif self.error_register & ~_GENERIC_BIT == _COMMUNICATION_BIT:
            self.error_code, self.communication_code = None, code
        else:
            self.error_code, self.communication_code = code if self.error_register else None, None

    def _observe_heartbeat(self, state: int, t_ns: int) -> None:
        if state == BOOT_UP:
            self.error_code, self.communication_code, self.error_register = None, None, 0
        self.state, self.heard_ns = state & ~_GUARDING_TOGGLE, t_ns
