"""Samples as the driver brings them: how many are good, and how fast they come."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from daemon.doctor.report import Check, fault, not_checked, ok, warning
from daemon.imu.ports import OpenLine
from drivers.acquisition import prefer_this_thread
from drivers.adis16448.burst import Burst, BurstDecoder, Fault
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.machine import InertialSensor
from drivers.adis16448.performance import CLOCK_ERROR
from drivers.adis16448.quality import MISSED, WORDS
from drivers.clock import Clock
from drivers.condition import Condition
from drivers.spi import SpiTransport
from estimation.records import ImuSample, TimeKind

SAMPLES, RATE = "samples", "sample rate"
NAMES = (SAMPLES, RATE, "noise at rest", "gyroscopes at rest", "gravity", "up axis", "temperature")
_START_S = 3.0  # to reset, test and configure, several times if need be
_ILL_SHARE, _BAD_SHARE = 0.01, 0.1
_OF_COMPUTER = ("torn", "missed")
_LEAST_EDGES = 20


@dataclass(slots=True, frozen=True)
class Read:
    """What a few seconds brought."""

    bursts: list[Burst]
    good: list[ImuSample]
    missed: int
    bad: dict[str, int]  # by kind, zeros left out
    condition: Condition  # of the driver, at the end


def read(
    settings: ImuSettings,
    clock: Clock,
    open_port: Callable[[], SpiTransport],
    open_line: OpenLine | None,
    seconds: float,
) -> Read:
    """Run the driver for so long, from its first sample on."""
    if settings.realtime_priority is not None:
        # As the daemon's thread; not this one, which has other things to do afterwards.
        with ThreadPoolExecutor(1, initializer=prefer_this_thread, initargs=(settings.realtime_priority,)) as thread:
            return thread.submit(_read, settings, clock, open_port, open_line, seconds).result()
    return _read(settings, clock, open_port, open_line, seconds)


def _read(
    settings: ImuSettings,
    clock: Clock,
    open_port: Callable[[], SpiTransport],
    open_line: OpenLine | None,
    seconds: float,
) -> Read:
    sensor = InertialSensor(settings, clock, open_port, open_line)
    decoder = BurstDecoder(settings.gyro_range_dps)
    bursts: list[Burst] = []
    end_ns = clock.now_ns() + round((_START_S + seconds) * 1e9)
    driver = logging.getLogger("drivers")
    level = driver.level
    driver.setLevel(logging.CRITICAL)  # what it says stands in the checks
    try:
        while clock.now_ns() < end_ns:
            block = [item for item in sensor.read_block() if isinstance(item, Burst)]
            if block and not bursts:
                end_ns = clock.now_ns() + round(seconds * 1e9)
            bursts += block
    finally:
        sensor.close()
        driver.setLevel(level)
    counters = sensor.counters
    good = [decoder.sample(burst) for burst in bursts if burst.fault is Fault.NONE]
    bad = {kind: count for kind, count in counters.faults.items() if count}
    return Read(bursts, good, counters.missed + counters.missed_paced, bad, sensor.condition)


def examine(read: Read, settings: ImuSettings) -> list[Check]:
    """Goodness and pace."""
    if not read.bursts:
        what, advice = read.condition.what or "no sample came", read.condition.advice or "mend what stands above first"
        return [fault(SAMPLES, f"no sample came: {what}", advice), not_checked(RATE, "no sample came")]
    return [judge_samples(len(read.bursts), read.missed, read.bad), judge_rate(read.bursts, settings)]


def judge_samples(count: int, missed: int, bad: dict[str, int]) -> Check:
    """Whether the wires, or the computer, spoil too many."""
    lost = {**bad, "missed": missed} if missed else bad
    share = sum(lost.values()) / (count + missed)
    words = ", ".join(f"{number} {kind.replace('_', ' ')}" for kind, number in lost.items())
    found = f"{count} samples" + (f", of these and beside them {words} ({share:.1%})" if lost else ", all good")
    figures = {"read": count, "missed": missed, "bad": bad, "bad_share": round(share, 4)}
    if share <= _ILL_SHARE:
        return ok(SAMPLES, found, **figures)
    worst = max(lost, key=lambda kind: lost[kind])
    what, advice = WORDS.get(worst, MISSED)
    is_fault = share > _BAD_SHARE and worst not in _OF_COMPUTER
    return (fault if is_fault else warning)(SAMPLES, f"{what}: {found}", advice, **figures)


def judge_rate(bursts: list[Burst], settings: ImuSettings) -> Check:
    """Of the part's own clock, which only edges tell."""
    nominal_hz = settings.nominal_rate_hz
    times = [burst.t_ns for burst in bursts if burst.time_kind is TimeKind.EDGE]
    if len(times) < _LEAST_EDGES:
        return not_checked(RATE, "only the edges of the data-ready line tell the part's own pace", "connect that line")
    rate_hz = rate_of(times)
    off = rate_hz / nominal_hz - 1
    found = f"{rate_hz:.1f} samples a second, {off:+.2%} off {nominal_hz:.1f} (± {CLOCK_ERROR:.0%} by the data sheet)"
    if abs(off) <= CLOCK_ERROR:
        return ok(RATE, found, rate_hz=round(rate_hz, 2), off=round(off, 5))
    advice = "check the data-ready wire for disturbance; if it is sound, the part's clock is off: replace the sensor"
    return warning(RATE, found, advice, rate_hz=round(rate_hz, 2), off=round(off, 5))


def rate_of(times_ns: list[int]) -> float:
    """Edges a second, single ones missing."""
    steps = np.diff(np.array(times_ns, dtype=np.int64))
    usual_ns = float(np.median(steps))
    # An interrupt that comes late makes one step long and the next short: neither counts as a period of its own.
    periods = np.rint(steps / usual_ns).sum()
    return float(periods / ((times_ns[-1] - times_ns[0]) * 1e-9))
