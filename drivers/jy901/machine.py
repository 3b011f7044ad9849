"""The JY901 as the program knows it: it brings samples and survives what happens to its line."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator
from dataclasses import replace

from drivers.clock import Clock
from drivers.condition import OK, Condition, Wellness
from drivers.jy901.counters import Jy901Counters
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.port import PortError, SerialPort
from drivers.jy901.quality import QualityWatch
from drivers.jy901.reading import Reading
from drivers.jy901.samples import SampleReader
from drivers.jy901.set_up import Found, Jy901Error, bandwidth_hz, set_up
from drivers.jy901.settings import Jy901Settings
from drivers.quiet_log import QuietLog

RETRY_S = 0.5
SILENT_S = 0.5  # without a sample: it is said
GARBLED_S, GARBLED_BYTES = 0.3, 44  # that make no sample: the part was without supply, speaks at another baud rate
LOST_S = 5.0  # without a byte: it is looked for anew, at every baud rate
SLOW_NS = 10_000_000_000  # a part that sends far too few samples has lost its settings; it is set up again that often
_SLICE_S = 0.05
_DEAD_BAND = 400  # samples in a row whose rate is exactly zero; noise does not do that

_SOUGHT = Condition(Wellness.WAITING, "the part is looked for on the serial line", "this takes a second or two")
_SILENT = Condition(Wellness.WAITING, "nothing comes on the serial line", "check the sensor's cable and its supply")
_GARBLED = Condition(
    Wellness.WAITING,
    "bytes come that are no samples",
    "the part is looked for anew; check its supply if that comes often",
)
_SLOW = Condition(Wellness.WAITING, "the part has lost its settings", "check the sensor's supply")
_AGAIN = "it is tried again and again; see port in [jy901]"
_DEAD_BAND_NOTE = (
    "the gyroscopes read exactly zero: the part's dead band hides slow rates, so no bias can be seen at rest and no "
    "heading found"
)

_log = logging.getLogger(__name__)


class Jy901:
    """One JY901 on its serial port.

    Nothing is opened before the first `read_block`. One caller; other threads may read the public attributes.

    Args:
        settings: how the part is wired and read.
        clock: of the run.
        open_port: opens the serial port; raises PortError.
    """

    def __init__(self, settings: Jy901Settings, clock: Clock, open_port: Callable[[], SerialPort]) -> None:
        self.identity: Jy901Identity | None = None  # of the part that delivers, or did last
        self.notes: list[str] = []  # what a person should know although all is well
        self.counters = Jy901Counters()
        self.condition = Condition(Wellness.WAITING, "not started yet")
        self.progress = 0  # moves as long as the caller and the port come back

        self._settings = settings
        self._clock = clock
        self._open_port = open_port
        self._quiet = QuietLog(_log, clock)
        self._port: SerialPort | None = None
        self._work: Generator[None, None, Found] | None = None  # on the way to data
        self._reader: SampleReader | None = None
        self._past = Jy901Counters()  # of readers that are gone
        self._not_before_ns = clock.now_ns()
        self._heard_ns = 0  # last sample
        self._garbled_ns: int | None = None  # first bytes after it
        self._garbled = 0  # bytes after it
        self._slow_ns = 0
        self._quality = QualityWatch(self.counters, settings.rate_hz)
        self._is_frozen = False
        self._zeros = 0

    def read_block(self) -> list[Reading | Jy901Identity]:
        """The samples that came, a Jy901Identity first whenever the part was set up.

        Raises nothing and returns within about 0.1 s.
        """
        items: list[Reading | Jy901Identity] = []
        self.progress += 1
        try:
            if self._port is None:
                self._open()
            elif self._work is not None:
                self._go_on(self._work, items)
            else:
                self._take(items)
        except PortError as error:
            self.counters.port_failures += 1
            self.counters.last_error = str(error)
            self._lose_port()
            self._pause(str(error), _AGAIN)
        except Jy901Error as error:
            self.counters.failed_starts += 1
            self._lose_port()  # an adapter that was plugged in anew may have another node under the same name
            self._pause(error.what, error.advice)
        except Exception as error:
            self.counters.errors += 1
            self.counters.last_error = f"{type(error).__name__}: {error}"
            if self.counters.errors == 1:
                _log.exception("JY901: a fault of the program, which goes on")
            self._lose_port()
            self._pause(f"a fault of the program ({self.counters.last_error})", "report it")
        return items

    def close(self) -> None:
        """Give the port back."""
        self._quiet.flush(at_end=True)
        self._lose_port()

    # --- the way to data --------------------------------------------------------------------------------------

    def _open(self) -> None:
        ahead_s = (self._not_before_ns - self._clock.now_ns()) / 1e9
        if ahead_s > 0:
            self._clock.sleep(min(ahead_s, _SLICE_S))
            return
        self._port = self._open_port()
        self._start_anew(_SOUGHT)

    def _start_anew(self, condition: Condition) -> None:
        assert self._port is not None
        self._forget_reader()
        self._work = set_up(self._port, self._settings, self._clock)
        self.condition = condition

    def _go_on(self, work: Generator[None, None, Found], items: list[Reading | Jy901Identity]) -> None:
        try:
            next(work)
        except StopIteration as done:
            self._work = None
            self._begin(done.value, items)

    def _begin(self, found: Found, items: list[Reading | Jy901Identity]) -> None:
        now_ns, known = self._clock.now_ns(), self.identity
        self.identity = Jy901Identity(now_ns, found.firmware, found.baud, float(self._settings.rate_hz))
        items.append(self.identity)
        self.counters.starts += 1
        self._reader = SampleReader(found.baud, self._settings.rate_hz, bandwidth_hz(self._settings))
        self._heard_ns = now_ns
        self._quality.begin()
        self._is_frozen = False
        self._garbled_ns, self._garbled = None, 0
        if known is None:
            self._quiet.say(logging.INFO, f"{self.identity.name} is running at {found.baud} baud")
        elif known.is_same_part(self.identity):
            self._quiet.say(logging.INFO, "JY901: the part was set up again")
        else:
            self.counters.other_parts += 1
            self._quiet.say(logging.WARNING, f"JY901: another part, firmware {found.firmware}")
        self.condition = OK

    # --- data -------------------------------------------------------------------------------------------------

    def _take(self, items: list[Reading | Jy901Identity]) -> None:
        assert self._port is not None
        assert self._reader is not None
        data = self._port.read()
        now_ns = self._clock.now_ns()
        readings = self._reader.feed(data, now_ns) if data else []
        for reading in readings:
            self._watch(reading)
        items += readings
        self._count()
        if readings:
            if now_ns - self._heard_ns > SILENT_S * 1e9:
                self._quality.begin()
            self._heard_ns, self._garbled_ns, self._garbled = now_ns, None, 0
            if self._quality.is_due(now_ns):
                self._judge(now_ns)
        else:
            self._bear_silence(now_ns, len(data))

    def _bear_silence(self, now_ns: int, count: int) -> None:
        """A cable that is plugged in again goes on as before; a part that was without supply must be found anew."""
        self._garbled += count
        if count and self._garbled_ns is None:
            self._garbled_ns = now_ns
        is_late = self._garbled_ns is not None and now_ns - self._garbled_ns > GARBLED_S * 1e9
        if is_late and self._garbled >= GARBLED_BYTES:  # more than half a sample before a cable was pulled
            self._start_anew(_GARBLED)
        elif now_ns - self._heard_ns > LOST_S * 1e9:
            self._start_anew(_SILENT)
        elif now_ns - self._heard_ns > SILENT_S * 1e9 and self.condition != _SILENT:
            self.counters.silences += 1
            self.condition = _SILENT

    def _watch(self, reading: Reading) -> None:
        self.counters.samples += 1
        self.counters.frozen += reading.is_frozen
        self._is_frozen = reading.is_frozen
        self._zeros = 0 if any(reading.gyro[:3]) else self._zeros + 1
        if self._zeros == _DEAD_BAND and _DEAD_BAND_NOTE not in self.notes:
            self.notes.append(_DEAD_BAND_NOTE)
            self._quiet.say(logging.WARNING, f"JY901: {_DEAD_BAND_NOTE}")

    def _count(self) -> None:
        reader, past, counters = self._reader, self._past, self.counters
        if reader is None:
            return
        counters.halves = past.halves + reader.halves
        counters.missed = past.missed + reader.clock.missed
        counters.bad_checksums = past.bad_checksums + reader.parser.bad_checksums
        counters.skipped_bytes = past.skipped_bytes + reader.parser.skipped

    def _forget_reader(self) -> None:
        self._count()
        self._past = replace(self.counters)
        self._reader = None

    def _judge(self, now_ns: int) -> None:
        self._quiet.flush()
        complaints = self._quality.complaints(now_ns, is_frozen=self._is_frozen)
        if self._quality.has_lost_settings and now_ns - self._slow_ns > SLOW_NS:
            self._slow_ns = now_ns
            self._start_anew(_SLOW)
        elif complaints:
            self.condition = Condition(Wellness.ILL, "; ".join(what for what, _ in complaints), complaints[0][1])
        else:
            self.condition = OK

    # --- when things go wrong -----------------------------------------------------------------------------------

    def _pause(self, what: str, advice: str) -> None:
        self.condition = Condition(Wellness.WAITING, what, advice)
        self._not_before_ns = self._clock.now_ns() + round(RETRY_S * 1e9)

    def _lose_port(self) -> None:
        self._forget_reader()
        self._work = None
        port, self._port = self._port, None
        if port is not None:
            port.close()
