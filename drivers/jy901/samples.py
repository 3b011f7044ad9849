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
        self._began = False
        self._last: tuple[object, object] = (None, None)

    def feed(self, data: bytes, t_ns: int) -> list[Reading]:
        """Samples that these bytes complete; `t_ns`: when the last of the bytes arrived.

        A packet's time is that of its first byte, counted back over the bytes behind it at the line's pace. Samples
        that come all at once have waited: they were taken a period apart.
        """
        pairs, period_ns = self._pairs(self.parser.feed(data), t_ns), self.clock.period_ns
        readings = []
        for behind, (accel, gyro, came_ns, was_disturbed) in zip(range(len(pairs) - 1, -1, -1), pairs, strict=True):
            waited_since_ns = pairs[-1][2] - round(behind * period_ns)
            taken_ns = self.clock.time(min(came_ns, waited_since_ns), was_disturbed=was_disturbed)
            readings.append(Reading(taken_ns, accel.words, gyro.words, self._is_frozen(accel, gyro)))
        return readings

    def _pairs(self, packets: list[Packet], t_ns: int) -> list[tuple[Packet, Packet, int, bool]]:
        """ACCEL and GYRO of each group, when the first came, and whether bytes that belong to none came before."""
        pairs, end = [], self.parser.fed
        for packet in packets:
            if packet.kind is Kind.ACCEL:
                self.halves += self._accel is not None
                self._accel, self._began = packet, True
                self._accel_ns = t_ns - round((end - packet.at) * self._byte_ns)
            elif packet.kind is Kind.GYRO:
                accel, self._accel = self._accel, None
                if accel is None:
                    self.halves += self._began  # what came before we listened is no loss
                    continue
                skipped, self._skipped = self._skipped, self.parser.skipped + self.halves
                pairs.append((accel, packet, self._accel_ns, self._skipped > skipped))
        return pairs

    def _is_frozen(self, accel: Packet, gyro: Packet) -> bool:
        words = (accel.words[:3], gyro.words[:3])
        self._run = self._run + 1 if words == self._last else 0
        self._last = words
        return self._run >= self._longest_run
