"""The codes of CANopen nodes in words (CiA 301: emergency error codes, heartbeat states)."""

from __future__ import annotations

BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127

NODE_STATES = {
    BOOT_UP: "booting",
    STOPPED: "stopped",
    OPERATIONAL: "operational",
    PRE_OPERATIONAL: "pre-operational",
}

# From the particular to the general: a whole code, else its upper byte, else its upper four bits.
_CODES = {
    0x5000: "no magnet or another hardware fault",
    0x8110: "CAN overrun",
    0x8120: "CAN controller error-passive",
    0x8130: "heartbeat or life guard missing",
    0x8140: "recovered from bus-off",
    0x8150: "CAN identifier used twice",
}
_CLASSES = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current at the input side",
    0x22: "current inside the device",
    0x23: "current at the output side",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "device temperature",
    0x50: "device hardware",
    0x60: "device software",
    0x61: "internal software",
    0x62: "user software",
    0x63: "data set error",
    0x70: "additional modules",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "device specific error",
}


def emergency_words(code: int, register: int) -> str:
    """An emergency in words, with its code for the sensor's manual.

    Args:
        code: emergency error code, 16 bits.
        register: error register (object 1001h), 8 bits.
    """
    if code >> 8 == 0:  # one error went away
        return f"an error remains (error register 0x{register:02X})"
    words = _CODES.get(code) or _CLASSES.get(code >> 8) or _CLASSES.get(code >> 8 & 0xF0, "unknown error")
    return f"{words} (error 0x{code:04X})"
