"""How well the sensor is read: the share of bad and missed samples over the last seconds, in words."""

from __future__ import annotations

from collections import deque

from drivers.adis16448.burst import Fault
from drivers.adis16448.counters import FAULT_NAMES, Counters
from drivers.adis16448.registers import (
    DIAG_BAROMETER,
    DIAG_MAGNETOMETER,
    DIAG_OVERRANGE,
    DIAG_SENTENCES,
    DIAG_SPI,
    diagnoses,
)

_STEP_NS = 500_000_000
_STEPS = 10
_ILL_SHARE, _WELL_SHARE = 0.01, 0.005
_LEAST_BAD = 3  # one in a short time is a large share, and nothing
_DIAGNOSIS_NS = 10_000_000_000
_ONCE_MORE_WITHIN = 4  # bursts
# Nothing here needs these two, and a magnet nearby fails the one.
_HARMLESS = DIAG_MAGNETOMETER | DIAG_BAROMETER

_REPLACE = "if that goes on after the supply was switched off and on, replace the sensor"
_DIAGNOSIS_ADVICE = {
    DIAG_SENTENCES[DIAG_OVERRANGE]: "check its mounting for hard shocks, or choose a larger gyro_range_dps in [imu]",
    DIAG_SENTENCES[DIAG_SPI]: "check the wires SCLK and CS, and that nothing else uses this SPI port",
}

_TOO_LATE = 'lessen the load of this computer, or set realtime_priority or acquisition = "process" in [imu]'
_UNSEEN = "unseen"
MISSED = ("samples are missed: reads come too late", _TOO_LATE)
WORDS: dict[str, tuple[str, str]] = {
    FAULT_NAMES[Fault.CRC]: (
        "samples fail their checksum",
        "check the wires SCLK, DOUT (MISO) and ground for length and contact, and that nothing else uses this SPI port",
    ),
    FAULT_NAMES[Fault.REPEATED]: (
        "samples come twice, or the sensor stands still",
        "check the data-ready wire for contact and disturbance, and data_ready_active_high in [imu]",
    ),
    FAULT_NAMES[Fault.ALL_ZERO]: (
        "samples are all zeros",
        "the data wire (DOUT, MISO) stays low: check the sensor's supply and that wire",
    ),
    FAULT_NAMES[Fault.ALL_ONE]: (
        "samples are all ones",
        "the data wire (DOUT, MISO) floats: check that the sensor is plugged in and its chip select (CS)",
    ),
    FAULT_NAMES[Fault.SPI]: (
        "transfers fail",
        "check the SPI port of this computer and the wires SCLK and CS",
    ),
    _UNSEEN: (
        "edges of the data-ready line do not arrive",
        "check the data-ready wire for contact and disturbance, and data_ready_* in [imu]",
    ),
    FAULT_NAMES[Fault.TORN]: ("samples are torn: reads meet the next sample", _TOO_LATE),
    FAULT_NAMES[Fault.OUT_OF_RANGE]: (
        "samples are beyond what the sensor can measure",
        "check its mounting for hard shocks, and the wires SCLK and DOUT (MISO)",
    ),
}


class QualityWatch:
    """Judges the counters of the last five seconds; ill above 1 %, well again below 0.5 %."""

    def __init__(self, counters: Counters) -> None:
        self._counters = counters
        self._marks: deque[dict[str, int]] = deque(maxlen=_STEPS + 1)
        self._due_ns = 0
        self._is_ill = False
        self._worst = ""
        self._suspected: dict[int, int] = {}  # DIAG_STAT bit: number of the last burst that held it
        self._seen: dict[int, int] = {}  # last time that it was confirmed

    def latch(self, diag_stat: int, t_ns: int) -> None:
        """Count the faults of a DIAG_STAT word, which reading it has cleared in the part."""
        for sentence in diagnoses(diag_stat):
            self._counters.diagnoses[sentence] += 1
        read = self._counters.samples
        for bit in (1 << number for number in range(16)):
            if diag_stat & bit:
                # No checksum covers this word; a fault that is one comes back with the next sample.
                if read - self._suspected.get(bit, -_ONCE_MORE_WITHIN - 1) <= _ONCE_MORE_WITHIN:
                    self._seen[bit] = t_ns
                self._suspected[bit] = read

    def complaints(self, now_ns: int) -> list[tuple[str, str]]:
        """What is wrong and what to do about it, the worst first; call several times a second."""
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + _STEP_NS
            self._judge()
        said = [WORDS.get(self._worst, MISSED)] if self._is_ill else []
        recent = sum(bit for bit, t_ns in self._seen.items() if now_ns - t_ns < _DIAGNOSIS_NS) & ~_HARMLESS
        for sentence in diagnoses(recent):
            said.append((f"the sensor says: {sentence}", _DIAGNOSIS_ADVICE.get(sentence, _REPLACE)))
        return said

    def _judge(self) -> None:
        counters = self._counters
        now = {
            **counters.faults,
            "missed": counters.missed + counters.missed_paced,
            _UNSEEN: counters.missed_unseen + counters.missed_silent,
            "samples": counters.samples,
        }
        self._marks.append(now)
        lost = {kind: now[kind] - self._marks[0][kind] for kind in now}
        samples = lost.pop("samples") + lost["missed"] + lost[_UNSEEN]
        bad = sum(lost.values())
        if self._is_ill:
            self._is_ill = bad > _WELL_SHARE * samples
        else:
            self._is_ill = bad > _ILL_SHARE * samples and bad >= _LEAST_BAD
        if self._is_ill and bad:
            self._worst = max(lost, key=lambda kind: lost[kind])
