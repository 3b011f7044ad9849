"""The virtual JY901's serial port within the process."""

from __future__ import annotations

from drivers.clock import Clock
from drivers.jy901.port import READ_S, PortError
from drivers.virtual.jy901_line import VirtualLine

_SAMPLE = 22  # bytes
_SLICE_S = 0.001


class VirtualSerialPort:
    """A SerialPort. Raises PortError while the script has the adapter pulled out."""

    def __init__(self, line: VirtualLine, clock: Clock) -> None:
        self.baudrate = 9600
        self._line = line
        self._clock = clock
        self._insist()

    def read(self) -> bytes:
        """What has come; in simulated time whoever waits lets time pass."""
        until_ns = self._clock.now_ns() + round(READ_S * 1e9)
        data = b""
        while True:
            self._insist()
            now_ns = self._clock.now_ns()
            data += self._line.arrived(now_ns, self.baudrate)
            if len(data) >= _SAMPLE or now_ns >= until_ns:
                return data
            self._clock.sleep(_SLICE_S)
            if self._clock.now_ns() == now_ns:  # a clock that others move
                return data

    def write(self, data: bytes) -> None:
        """To the part."""
        self._insist()
        self._line.write(data, self._clock.now_ns(), self.baudrate)

    def close(self) -> None:
        """Nothing to release."""

    def _insist(self) -> None:
        now_ns = self._clock.now_ns()
        if self._line.is_gone(now_ns):
            self._line.arrived(now_ns, self.baudrate)  # the part goes on
            raise PortError("the serial port of the virtual JY901 is gone, as its fault script says")
