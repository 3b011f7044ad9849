"""What a message carries to protect itself: a counter that moves with every frame, and a checksum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cantools.database.can import Message, Signal

from drivers.can.checksums import CHECKSUMS
from drivers.can.settings import CanConfigError, ChecksumName

_LONGEST_COUNTER_BITS = 64


@dataclass(slots=True, frozen=True)
class CounterSignal:
    """A message counter: raw values from `lowest` on, `numbers` of them, then over."""

    name: str
    lowest: int
    numbers: int


@dataclass(slots=True, frozen=True)
class ChecksumSignal:
    """A checksum over all bytes of the message but its own."""

    name: str
    place: int  # index of its byte
    length: int  # of the message; what an FD frame is padded with is not covered
    calculate: Callable[[bytes], int]

    def of(self, data: bytes) -> int:
        """What the checksum of `data` should be."""
        return self.calculate(data[: self.place] + data[self.place + 1 : self.length])

    def fits(self, data: bytes) -> bool:
        """Whether `data`, at least as long as the message, holds the right checksum."""
        return data[self.place] == self.of(data)


def counter_signal(signal: Signal) -> CounterSignal:
    """The counter in `signal`; its range is the one that the DBC file states, else all that its bits can hold.

    Raises:
        CanConfigError: it is no integer, or longer than any counter.
    """
    if signal.conversion.is_float or signal.length > _LONGEST_COUNTER_BITS:
        raise CanConfigError(
            f'Signal "{signal.name}" (option `counter_signal`) is no integer of up to {_LONGEST_COUNTER_BITS} bits: '
            "name the one that counts the frames."
        )
    lowest = -(1 << signal.length - 1) if signal.is_signed else 0
    highest = lowest + (1 << signal.length) - 1
    if signal.minimum is not None and signal.maximum is not None:
        ends = [round((end - signal.offset) / signal.scale) for end in (signal.minimum, signal.maximum)]
        if lowest <= min(ends) < max(ends) <= highest:
            lowest, highest = min(ends), max(ends)
    return CounterSignal(signal.name, lowest, highest - lowest + 1)


def checksum_signal(message: Message, signal: Signal, kind: ChecksumName) -> ChecksumSignal:
    """The checksum in `signal` of `message`.

    Raises:
        CanConfigError: it is not exactly one byte of the frame.
    """
    # The start bit of a DBC file is the lowest of an Intel signal, the highest of a Motorola one.
    first_of_byte = 0 if signal.byte_order == "little_endian" else 7
    if signal.length != 8 or signal.start % 8 != first_of_byte or signal.conversion.is_float:
        raise CanConfigError(
            f'Signal "{signal.name}" (option `checksum_signal`) is not one whole byte of the frame: '
            "name the 8-bit checksum, or delete `checksum_signal` and `checksum`."
        )
    return ChecksumSignal(signal.name, signal.start // 8, message.length, CHECKSUMS[kind])
