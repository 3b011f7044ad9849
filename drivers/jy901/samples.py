"""Samples out of the JY901's bytes, with the time at which they were taken as well as arrival tells it."""

from __future__ import annotations

from drivers.jy901.pace import SampleClock
from drivers.jy901.packets import Kind, Packet, Parser
from drivers.jy901.reading import Reading

BITS_PER_BYTE = 10
FROZEN_SAMPLES = 12  # equal words in a row; noise changes one of six at nearly every sample,
FROZEN_PERIODS = 4.0  # or, where the part's filter is slower than its samples, at least within so many of its periods


class SampleReader:
    """Joins the ACCEL and the GYRO packet of a group; half a group is counted and left out."""

    def __init__(self, baud: int, rate_hz: float, bandwidth_hz: float) -> None:
        self.parser = Parser()
        self.clock = SampleClock(rate_hz)
        self.halves = 0  # groups of which one packet was lost
        self._byte_ns = BITS_PER_BYTE * 1e9 / baud
        self._longest_run = max(FROZEN_SAMPLES, round(FROZEN_PERIODS / bandwidth_hz * rate_hz))
        self._run = 0
        self._skipped = 0  # bytes and halves before the last sample
        self._accel: Packet | None = None
        self._accel_ns = 0
        self._last: tuple[object, object] = (None, None)

    def feed(self, data: bytes, t_ns: int) -> list[Reading]:
        """Samples that these bytes complete; `t_ns`: when the last of the bytes arrived.

        A packet's time is that of its first byte, counted back over the bytes behind it at the line's pace.
        """
        packets = self.parser.feed(data)
        end = self.parser.fed
        readings = []
        for packet in packets:
            if packet.kind is Kind.ACCEL:
                self.halves += self._accel is not None
                self._accel, self._accel_ns = packet, t_ns - round((end - packet.at) * self._byte_ns)
            elif packet.kind is Kind.GYRO:
                if self._accel is None:
                    self.halves += self._accel_ns > 0  # what came before we listened is no loss
                    continue
                accel, self._accel = self._accel, None
                skipped, self._skipped = self._skipped, self.parser.skipped + self.halves
                t_taken_ns = self.clock.time(self._accel_ns, was_disturbed=self._skipped > skipped)
                readings.append(Reading(t_taken_ns, accel.words, packet.words, self._is_frozen(accel, packet)))
        return readings

    def _is_frozen(self, accel: Packet, gyro: Packet) -> bool:
        words = (accel.words[:3], gyro.words[:3])
        self._run = self._run + 1 if words == self._last else 0
        self._last = words
        return self._run >= self._longest_run
