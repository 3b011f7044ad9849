"""The inertial sensor as the program knows it: one state machine that brings samples and survives everything.

A fault of a sample costs one, a good sample pays one back; more than ten open faults start the part anew, as
PX4's driver of this part does.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

from drivers.adis16448.burst import Burst, Fault
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.counters import FAULT_NAMES, Counters
from drivers.adis16448.device import Adis16448, ChecksumMissing, ImuError
from drivers.adis16448.identity import Identity
from drivers.adis16448.quality import WORDS, QualityWatch
from drivers.adis16448.sampler import Sampler
from drivers.clock import Clock
from drivers.condition import OK, Condition, Wellness
from drivers.data_ready import DataReady
from drivers.quiet_log import QuietLog
from drivers.sample_timer import SampleTimer
from drivers.spi import SpiError, SpiTransport

# Times of the data sheet (Rev. E, table "specifications").
RESET_S = 0.090
POWER_ON_S = 0.205
SELF_TEST_S = 0.045  # times 2^D of the decimation

FIRST_RETRY_S, LONGEST_RETRY_S = 0.5, 5.0
_HANDOVER_S = 0.1  # a block is handed over at this age even if it is not full; no call lasts much longer
_IDENTIFY_PAUSE_S = 0.1
_IDENTIFY_ATTEMPTS = 10  # then another reset
_SELF_TEST_LIMIT_S = 1.0
_POLL_S = 0.005
_PORT_ATTEMPTS = 3  # transfers that fail in a row; then the port is opened anew
_CHECK_NS = 100_000_000  # one register
_MOST_OPEN_FAULTS = 10
_FAILURES_TO_BELIEVE = 3  # in a row, of the self-test or of the checksum: then they are the part's, not the wire's
_STEADY_S = 1.0  # a part that delivers so long ends the growth of the pauses
_RESTART_TOLD_NS = 10_000_000_000
_JUDGE_NS = 250_000_000

_AGAIN = "it is tried again and again; see transport and spi_device in [imu]"
_DEAD_WIRE = (Fault.ALL_ZERO, Fault.ALL_ONE)  # registers read the same, which says nothing about them

_log = logging.getLogger(__name__)


class State(StrEnum):
    """Where the part is on its way to data."""

    WAIT_FOR_PORT = "waiting for the SPI port"
    RESET = "reset"
    IDENTIFY = "identification"
    SELF_TEST = "self-test"
    VERDICT = "verdict of the self-test"
    CONFIGURE = "configuration"
    RUN = "running"
    RECOVER = "pause before another reset"


@dataclass(slots=True)
class _Past:
    """What one part did since the program started."""

    passed_test: bool = False
    failed_tests: int = 0  # in a row
    sent_crc: bool = False
    missing_crcs: int = 0  # starts in a row


class InertialSensor:
    """One ADIS16448 with its SPI port and its data-ready line.

    Nothing is opened before the first `read_block`. One caller; other threads may read the public attributes.

    Args:
        settings: how the part is wired and read.
        clock: of the run.
        open_port: opens the SPI port; raises SpiError.
        open_line: opens the data-ready line; raises DataReadyError. None: reads are paced.
    """

    def __init__(
        self,
        settings: ImuSettings,
        clock: Clock,
        open_port: Callable[[], SpiTransport],
        open_line: Callable[[], DataReady] | None,
    ) -> None:
        self.state = State.WAIT_FOR_PORT
        self.identity: Identity | None = None  # of the part that delivers, or did last
        self.notes: list[str] = []  # what a person should know although all is well
        self.counters = Counters()
        self.condition = Condition(Wellness.WAITING, "not started yet")
        self.progress = 0  # moves as long as the caller and the port come back

        self._settings = settings
        self._clock = clock
        self._open_port = open_port
        self._quiet = QuietLog(_log, clock)
        self._timer = SampleTimer(clock, settings.nominal_period_s, open_line)
        self._quality = QualityWatch(self.counters)
        self._sampler = Sampler(clock, self._timer, self.counters, self._quality, settings.filter_taps_exponent)
        self._steps = {
            State.WAIT_FOR_PORT: self._wait_for_port,
            State.RESET: self._reset,
            State.IDENTIFY: self._identify,
            State.SELF_TEST: self._self_test,
            State.VERDICT: self._verdict,
            State.CONFIGURE: self._configure,
            State.RUN: self._run,
            State.RECOVER: self._recover,
        }
        self._not_before_ns = clock.now_ns()
        self._retry_s = FIRST_RETRY_S

        self._port: SpiTransport | None = None
        self._opened: Adis16448 | None = None
        self._port_errors = 0
        self._attempts = 0  # to identify
        self._met: Identity | None = None  # on the way to data
        self._tested: Identity | None = None  # passed the self-test, and reachable ever since
        self._pasts: dict[tuple[int, int], _Past] = {}  # by lot and serial number
        self._test_notes: list[str] = []
        self._test_failure: tuple[str, str] | None = None  # of the part that is used all the same
        self._test_limit_ns = 0
        self._restart_reason: tuple[str, str] | None = None

        self._running_ns = 0  # start of the run
        self._check_ns = self._judge_ns = 0

    def read_block(self) -> list[Burst | Identity]:
        """The next samples, at most a block; fewer, even none, if they take longer than 0.1 s to come.

        An Identity comes first whenever the part was started. Raises nothing and returns within about 0.3 s.
        """
        items: list[Burst | Identity] = []
        self.progress += 1
        try:
            if self.state is State.RUN or self._is_time():
                self._steps[self.state](items)
            self._supervise()
        except SpiError as error:
            self._port_failed(error)
        except ImuError as error:
            self.counters.failed_starts += self.state is not State.VERDICT
            self.counters.failed_self_tests += self.state is State.VERDICT
            self._pause(State.RECOVER, error.what, error.advice)
        except Exception as error:
            self.counters.errors += 1
            self.counters.last_error = f"{type(error).__name__}: {error}"
            if self.counters.errors == 1:
                _log.exception("inertial sensor: a fault of the program, which goes on")
            state = State.WAIT_FOR_PORT if self._opened is None else State.RECOVER
            self._restart_reason = (f"a fault of the program ({self.counters.last_error})", "report it")
            self._pause(state, *self._restart_reason)
        return items

    def close(self) -> None:
        """Give port and line back."""
        self._quiet.flush(at_end=True)
        self._timer.close()
        if self._port is not None:
            with contextlib.suppress(OSError):  # a port that failed may refuse even that
                self._port.close()

    # --- the way to data --------------------------------------------------------------------------------------

    def _wait_for_port(self, _: list[Burst | Identity]) -> None:
        self._port = self._open_port()
        self._opened = Adis16448(self._port, self._clock, self._settings)
        self._port_errors = 0
        self._tested = None
        self._tell(Condition(Wellness.WAITING, "the part is being started"))
        self._enter(State.RESET)

    def _reset(self, _: list[Burst | Identity]) -> None:
        self._device.reset()
        self._enter(State.IDENTIFY, RESET_S)

    def _identify(self, _: list[Burst | Identity]) -> None:
        try:
            self._met = self._device.identify()
        except ImuError as error:
            self.counters.wrong_id += 1
            self._tested = None
            self._attempts += 1
            self._tell(Condition(Wellness.WAITING, error.what, error.advice))
            next_state = State.IDENTIFY if self._attempts % _IDENTIFY_ATTEMPTS else State.RESET
            self._enter(next_state, _IDENTIFY_PAUSE_S)
            return
        self._port_errors = 0
        if self._attempts:
            # It has just woken: let it come up, then ask again.
            self._attempts = 0
            self._enter(State.IDENTIFY, POWER_ON_S)
        elif self._tested is not None and self._tested.is_same_part(self._met):
            self._enter(State.CONFIGURE)
        else:
            self._enter(State.SELF_TEST)

    def _self_test(self, _: list[Burst | Identity]) -> None:
        self._test_failure = None
        self._device.begin_self_test()
        duration_s = SELF_TEST_S * (1 << self._settings.decimation_exponent)
        self._test_limit_ns = self._clock.now_ns() + round((duration_s + _SELF_TEST_LIMIT_S) * 1e9)
        self._enter(State.VERDICT, duration_s)

    def _verdict(self, _: list[Burst | Identity]) -> None:
        try:
            notes = self._device.self_test_verdict()
            if notes is None and self._clock.now_ns() > self._test_limit_ns:
                raise ImuError(f"the self-test did not end within {_SELF_TEST_LIMIT_S:g} s", "replace the sensor")
        except ImuError as error:
            self._confirm_identity()
            self._failed_test(error)
            return
        if notes is None:
            self._enter(State.VERDICT, _POLL_S)
            return
        self._confirm_identity()
        past = self._past()
        past.passed_test, past.failed_tests = True, 0
        self._test_notes = notes
        self._tested = self._met
        self._enter(State.CONFIGURE)

    def _confirm_identity(self) -> None:
        """Was it the part that gave the verdict, or a bad wire? Zeros read as a test that was passed."""
        try:
            self._device.identify()
        except ImuError:
            self.counters.wrong_id += 1
            self._enter(State.IDENTIFY)  # what failed was not the test
            raise

    def _failed_test(self, error: ImuError) -> None:
        """Try again, or use the part all the same: ill data are better than none, and are said to be ill."""
        past = self._past()
        past.failed_tests += 1
        if not past.passed_test and past.failed_tests < _FAILURES_TO_BELIEVE:
            raise error
        self.counters.failed_self_tests += 1
        self._test_failure = (f"{error.what}: its data are used all the same", error.advice)
        self._test_notes = [self._test_failure[0]]
        # The reset ends a test that hangs; the way from there leads past another one.
        self._tested = self._met
        self._enter(State.RESET)

    def _configure(self, items: list[Burst | Identity]) -> None:
        past = self._past()
        try:
            may_lack_crc = not past.sent_crc and past.missing_crcs >= _FAILURES_TO_BELIEVE
            self.notes = self._test_notes + self._device.configure(may_lack_crc=may_lack_crc)
        except ChecksumMissing:
            past.missing_crcs += 1
            raise
        if self._device.crc_active:
            past.sent_crc, past.missing_crcs = True, 0
        for note in self.notes:
            self._quiet.say(logging.WARNING, f"inertial sensor: {note}")
        assert self._met is not None
        known = self.identity
        self.counters.missed_starting += self._timer.skip()
        now_ns = self._clock.now_ns()
        self.identity = replace(self._met, t_ns=now_ns)
        items.append(self.identity)
        self.counters.starts += 1
        if known is None:
            self._quiet.say(logging.INFO, f"inertial sensor: serial {self.identity.serial} is running")
        elif self.identity.is_same_part(known):
            self._quiet.say(logging.INFO, f"inertial sensor: the part restarted, serial {known.serial}")
        else:
            self.counters.other_parts += 1
            self._timer.forget()
            self._quiet.say(logging.WARNING, f"inertial sensor: another part, serial {self.identity.serial}")
        self._sampler.begin()
        self._running_ns = now_ns
        self._check_ns = now_ns + _CHECK_NS
        self._judge_ns = now_ns
        self._timer.begin()
        self._enter(State.RUN)

    def _recover(self, _: list[Burst | Identity]) -> None:
        self._enter(State.RESET)

    # --- data -------------------------------------------------------------------------------------------------

    def _run(self, items: list[Burst | Identity]) -> None:
        timer, sampler, device = self._timer, self._sampler, self._device
        until_ns = self._clock.now_ns() + round(_HANDOVER_S * 1e9)
        for _ in range(self._settings.block_samples):
            edge = timer.next(until_ns)
            if edge is None:
                return
            burst = sampler.read(device, edge)
            items.append(burst)
            end_ns = sampler.end_ns
            if burst.fault is not Fault.NONE:
                self._weigh(burst.fault, end_ns)
            elif end_ns >= self._check_ns:
                self._check(end_ns)
            if self.state is not State.RUN or end_ns >= until_ns:
                return

    def _weigh(self, fault: Fault, now_ns: int) -> None:
        """After a bad sample: start anew if there are too many, else look for the cause."""
        sampler = self._sampler
        if sampler.open_faults > _MOST_OPEN_FAULTS:
            what, advice = WORDS[FAULT_NAMES[fault]]
            if sampler.port_errors >= _PORT_ATTEMPTS:
                self._give_port_up(self.counters.last_error)
            else:
                self._restart(what, advice)
        elif fault not in _DEAD_WIRE and not sampler.port_errors:
            self._check(now_ns)

    def _check(self, now_ns: int) -> None:
        """Is the next setting still there? A supply that failed for a moment has put the registers to defaults."""
        self._check_ns = now_ns + _CHECK_NS
        try:
            wrong = self._device.wrong_register()
        except SpiError as error:
            self.counters.failed_checks += 1
            self.counters.last_error = str(error)
            return
        if wrong is not None:
            self.counters.wrong_registers += 1
            self._restart(f"the part lost its settings ({wrong})", "check the sensor's supply")

    def _past(self) -> _Past:
        """Of the part that answers now."""
        assert self._met is not None
        return self._pasts.setdefault((self._met.lot_id, self._met.serial), _Past())

    @property
    def _device(self) -> Adis16448:
        assert self._opened is not None
        return self._opened

    # --- when things go wrong -----------------------------------------------------------------------------------

    def _is_time(self) -> bool:
        """On the way to data: let a slice of the wait pass; edges meanwhile are counted."""
        self.counters.missed_starting += self._timer.skip()
        ahead_s = (self._not_before_ns - self._clock.now_ns()) / 1e9
        if ahead_s > 0:
            self._clock.sleep(min(ahead_s, _HANDOVER_S))
        return self._clock.now_ns() >= self._not_before_ns

    def _enter(self, state: State, after_s: float = 0.0) -> None:
        self.state = state
        self._not_before_ns = self._clock.now_ns() + round(after_s * 1e9)

    def _pause(self, state: State, what: str, advice: str) -> None:
        self._tell(Condition(Wellness.WAITING, what, advice))
        self._enter(state, self._retry_s)
        self._retry_s = min(2 * self._retry_s, LONGEST_RETRY_S)

    def _restart(self, what: str, advice: str) -> None:
        """Start the part anew, at once: the reset itself is pause enough."""
        self._restart_reason = (what, advice)
        self._tell(Condition(Wellness.WAITING, what, advice))
        self._enter(State.RESET)

    def _give_port_up(self, what: str) -> None:
        self.counters.port_failures += 1
        self._restart_reason = (what, _AGAIN)
        port, self._port, self._opened = self._port, None, None
        if port is not None:
            with contextlib.suppress(OSError):
                port.close()
        self._pause(State.WAIT_FOR_PORT, what, _AGAIN)

    def _port_failed(self, error: SpiError) -> None:
        """On the way to data. The port is opened anew only when it fails again and again."""
        self._port_errors += 1
        self.counters.last_error = str(error)
        if self._port is None or self._port_errors >= _PORT_ATTEMPTS:
            self._give_port_up(str(error))
        else:
            self._tell(Condition(Wellness.WAITING, str(error), _AGAIN))
            self._enter(State.RECOVER, _IDENTIFY_PAUSE_S)

    def _supervise(self) -> None:
        """Counters, and several times a second the condition."""
        timer, counters = self._timer, self.counters
        counters.silences, counters.line_failures = timer.silences, timer.line_failures
        counters.missed_paced, counters.missed_silent = timer.missed_paced, timer.missed_silent
        counters.missed_unseen, counters.unheeded = timer.missed_unseen, timer.unheeded
        now_ns = self._clock.now_ns()
        if now_ns < self._judge_ns:
            return
        self._judge_ns = now_ns + _JUDGE_NS
        self._quiet.flush()
        complaints = self._quality.complaints(now_ns)
        if self.state is not State.RUN:
            return
        if timer.has_line and timer.is_paced:
            complaints.insert(0, self._about_line())
        if self._test_failure is not None:
            complaints.append(self._test_failure)
        if now_ns - self._running_ns >= _RESTART_TOLD_NS:
            self._restart_reason = None
        elif self._restart_reason is not None:
            what, advice = self._restart_reason
            complaints.append((f"the part was started anew: {what}", advice))
        if now_ns - self._running_ns >= _STEADY_S * 1e9:
            self._retry_s = FIRST_RETRY_S
        if complaints:
            self._tell(Condition(Wellness.ILL, "; ".join(what for what, _ in complaints), complaints[0][1]))
        else:
            self._tell(OK)

    def _about_line(self) -> tuple[str, str]:
        sparse, silent = "the data-ready line brings too few edges", "the data-ready line is silent"
        what = self._timer.line_error or (sparse if self._timer.is_sparse else silent)
        pin = self._settings.data_ready_pin
        return f"{what}: reads are paced", f"check the wire from DIO{pin} to the GPIO line, and data_ready_* in [imu]"

    def _tell(self, condition: Condition) -> None:
        self.condition = condition
