"""Samples out of the JY901's bytes, with the time at which they were measured as well as arrival tells it."""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.jy901.packets import Kind, Packet, Parser
from estimation.records import ImuSample, TimeKind

BITS_PER_BYTE = 10


@dataclass(slots=True)
class SampleReader:
    """Joins the ACCEL and the GYRO packet of a group; half a group is counted and left out."""

    baud: int
    parser: Parser = field(default_factory=Parser)
    halves: int = 0  # groups of which one packet was lost
    _accel: Packet | None = None
    _accel_ns: int = 0
    _last_ns: int = -(10**18)

    def feed(self, data: bytes, t_ns: int) -> list[ImuSample]:
        """Samples that these bytes complete; `t_ns`: when the last of the bytes arrived.

        A packet's time is that of its first byte, counted back over the bytes behind it at the line's pace. Time never
        goes back, whatever an adapter does that hands over bytes in heaps.
        """
        byte_ns = BITS_PER_BYTE * 1e9 / self.baud
        packets = self.parser.feed(data)
        end = self.parser.fed
        samples = []
        for packet in packets:
            began_ns = t_ns - round((end - packet.at) * byte_ns)
            if packet.kind is Kind.ACCEL:
                self.halves += self._accel is not None
                self._accel, self._accel_ns = packet, began_ns
            elif packet.kind is Kind.GYRO:
                if self._accel is None:
                    self.halves += 1
                    continue
                self._last_ns = max(self._accel_ns, self._last_ns + 1)
                samples.append(
                    ImuSample(self._last_ns, packet.gyro, self._accel.accel, self._accel.temperature_c, TimeKind.READ)
                )
                self._accel = None
        return samples
