"""Message layouts written as ROS 2 message text and packed with `struct`.

The byte format is plain CDR, little endian (OMG DDS-XTypes 7.4.3): four bytes of encapsulation header, then
the fields in order, each aligned to its own size, counted from behind the header.
"""

from __future__ import annotations

import struct
from typing import Any

ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR_LE, no options

_CODES = {
    "bool": "?",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "float64": "d",
}
_STAMP = "builtin_interfaces/Time"
_STRING, _BYTES = "string", "uint8[]"
_LENGTH = struct.Struct("<I")


class DecodeError(ValueError):
    """A message does not have the layout of its schema."""


def fields(text: str) -> list[list[str]]:
    """Type and name of the fields of a ros2msg text, in order; constants and dependent definitions are not fields."""
    found: list[list[str]] = []
    for line in text.splitlines():
        if line.startswith("==="):
            break
        words = line.partition("#")[0].split()
        if words and "=" not in "".join(words[1:]):
            found.append(words)
    return found


def _field_types(text: str) -> list[str]:
    types: list[str] = []
    for kind, *_ in fields(text):
        types += ["int32", "uint32"] if kind == _STAMP else [kind]
    return types


class Layout:
    """One message type: its name, its ros2msg text, and how to pack and unpack its fields.

    The fields of fixed size up to the first string or byte sequence form one precompiled `Struct` (the whole
    message for the fast ones); only what follows is walked field by field.
    """

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        self.text = text
        types = _field_types(text)
        self._fixed = next((i for i, kind in enumerate(types) if kind in (_STRING, _BYTES)), len(types))
        self._tail = types[self._fixed :]
        self.format = "<4s"  # with the encapsulation header as first value
        offset = 0
        for kind in types[: self._fixed]:
            size = struct.calcsize(_CODES[kind])
            padding = -offset % size
            self.format += "x" * padding + _CODES[kind]
            offset += padding + size
        self._struct = struct.Struct(self.format)

    def pack(self, *values: Any) -> bytes:
        """Bytes of one message; `struct.error` when a value does not fit its field."""
        head = self._struct.pack(ENCAPSULATION, *values[: self._fixed])
        if not self._tail:
            return head
        out = bytearray(head)
        for kind, value in zip(self._tail, values[self._fixed :], strict=True):
            size = 4 if kind in (_STRING, _BYTES) else struct.calcsize(_CODES[kind])
            out += bytes((len(ENCAPSULATION) - len(out)) % size)
            if kind == _STRING:
                # Words are never refused: a lone surrogate (from an odd file name) is written as its escape.
                raw = value.encode("utf-8", "backslashreplace") + b"\0"
                out += _LENGTH.pack(len(raw)) + raw
            elif kind == _BYTES:
                out += _LENGTH.pack(len(value)) + value
            else:
                out += struct.pack("<" + _CODES[kind], value)
        return bytes(out)

    def unpack(self, data: bytes) -> tuple[Any, ...]:
        """Values of one message; `DecodeError` when the bytes have another layout."""
        try:
            if not self._tail:
                values = self._struct.unpack(data)
            else:
                values = self._struct.unpack_from(data) + self._unpack_tail(data)
        except (struct.error, UnicodeDecodeError) as error:
            raise DecodeError(f"{self.name}: {error}") from error
        if values[0] != ENCAPSULATION:
            raise DecodeError(f"{self.name}: not little-endian CDR")
        return values[1:]

    def _unpack_tail(self, data: bytes) -> tuple[Any, ...]:
        values: list[Any] = []
        at = self._struct.size
        for kind in self._tail:
            code = _CODES.get(kind, "I")
            at += (len(ENCAPSULATION) - at) % struct.calcsize(code)
            (value,) = struct.unpack_from("<" + code, data, at)
            at += struct.calcsize(code)
            if kind in (_STRING, _BYTES):
                raw = data[at : at + value]
                if len(raw) != value or (kind == _STRING and raw[-1:] != b"\0"):
                    raise DecodeError(f"{self.name}: a {kind} runs past the end of the message")
                at += value
                value = raw[:-1].decode() if kind == _STRING else raw
            values.append(value)
        if at != len(data):
            raise DecodeError(f"{self.name}: {len(data) - at} bytes too many")
        return tuple(values)
