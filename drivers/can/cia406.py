"""What a CANopen linear encoder says about itself beside its position.

A CiA 406 sensor that lost its magnet may go on sending its last good position, so the position frame alone
proves nothing: the emergency object (EMCY, CiA 301) tells.
"""

from __future__ import annotations

import struct

from drivers.can.frame import Frame, FrameId

DEFAULT_NODE = 127

_EMCY_BASE = 0x080
_TPDO1_BASE = 0x180
_HEARTBEAT_BASE = 0x700
_EMERGENCY_HEAD = struct.Struct("<HB")  # error code, error register
_BOOT_UP = b"\x00"


def position_id(node: int) -> FrameId:
    """Identifier of the first transmit PDO of `node` (CiA 301 predefined connection set)."""
    return FrameId(_TPDO1_BASE + node)


def emergency_id(node: int) -> FrameId:
    """Identifier of the emergency object of `node`."""
    return FrameId(_EMCY_BASE + node)


def heartbeat_id(node: int) -> FrameId:
    """Identifier of the heartbeat and boot-up message of `node`."""
    return FrameId(_HEARTBEAT_BASE + node)


class EmergencyMonitor:
    """Remembers whether a node has an emergency pending.

    An emergency ends when the node reports "no error" with an empty error register, or when it boots anew.
    """

    def __init__(self, node: int) -> None:
        self.ids = (emergency_id(node), heartbeat_id(node))
        self.pending_code: int | None = None  # CiA 301 error code, None = no emergency
        self.received = 0
        self.malformed = 0

    def observe(self, frame: Frame) -> None:
        """Take in a frame; one with another identifier is ignored."""
        emergency, heartbeat = self.ids
        if frame.frame_id == emergency:
            self._observe_emergency(frame.data)
        elif frame.frame_id == heartbeat and frame.data == _BOOT_UP:
            self.pending_code = None

    def _observe_emergency(self, data: bytes) -> None:
        if len(data) < _EMERGENCY_HEAD.size:
            self.malformed += 1
            return
        self.received += 1
        code, register = _EMERGENCY_HEAD.unpack_from(data)
        # Code 0x00xx says that one error went away; the register tells whether others remain.
        is_clear = code >> 8 == 0 and register == 0
        self.pending_code = None if is_clear else code
