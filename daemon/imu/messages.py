"""What the acquiring process tells its parent: length and pickle, through a pipe that only these two hold."""

from __future__ import annotations

import os
import pickle
import select
import struct
from dataclasses import dataclass

from drivers.acquisition import AnyIdentity, Block
from drivers.adis16448.counters import Counters
from drivers.condition import Condition
from drivers.jy901.counters import Jy901Counters

_LENGTH = struct.Struct(">I")


@dataclass(slots=True)
class Orders:
    """What the parent tells the child, once."""

    settings_json: str
    start_ns: int  # of the virtual support


@dataclass(slots=True)
class Health:
    """How the sensor and the acquiring process are."""

    condition: Condition
    counters: Counters | Jy901Counters
    identity: AnyIdentity | None
    notes: list[str]
    progress: int
    dropped: int  # samples that found the buffer full


@dataclass(slots=True)
class LogLine:
    """A line for the parent's log."""

    logger: str
    level: int
    text: str


Message = Orders | Health | LogLine | Block


def send(fd: int, message: Message) -> None:
    """Write one message. Raises OSError if the other side is gone."""
    body = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    rest = memoryview(_LENGTH.pack(len(body)) + body)
    while rest:
        rest = rest[os.write(fd, rest) :]


def receive(fd: int, patience_s: float | None = None) -> Message | None:
    """Read one message; None at the end. Raises TimeoutError if nothing comes for `patience_s`."""
    head = _read(fd, _LENGTH.size, patience_s)
    body = head and _read(fd, _LENGTH.unpack(head)[0], patience_s)
    if not body:
        return None
    message: Message = pickle.loads(body)
    return message


def _read(fd: int, count: int, patience_s: float | None) -> bytes:
    """Exactly `count` bytes, or none at the end."""
    data = b""
    while len(data) < count:
        if not select.select([fd], [], [], patience_s)[0]:
            raise TimeoutError
        piece = os.read(fd, count - len(data))
        if not piece:
            return b""
        data += piece
    return data
