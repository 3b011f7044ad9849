"""The JY901: serial port, answer, rate, and what it feels at rest."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from daemon.doctor import node, rest
from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, fault, not_checked, ok, warning
from daemon.imu.ports import serial_opener
from drivers.condition import Condition
from drivers.jy901.counters import Jy901Counters
from drivers.jy901.identity import Jy901Identity
from drivers.jy901.machine import Jy901
from drivers.jy901.port import SerialPort
from drivers.jy901.reading import Reading
from drivers.jy901.settings import Jy901Settings

PORT, WHO, RATE, BAND = "serial port", "JY901", "JY901 rate", "JY901 dead band"
_START_S = 12.0  # to look for it at every baud rate, and to set it up
_SLOW_SHARE, _LOST_SHARE = 0.95, 0.01
_DEAD_SHARE = 0.5  # of samples without any rate; noise leaves one of fifty so


@dataclass(slots=True, frozen=True)
class Read:
    """What a few seconds brought."""

    readings: list[Reading]
    identity: Jy901Identity | None
    counters: Jy901Counters
    condition: Condition


def look(patient: Patient) -> list[Check]:
    """All checks of the part; those behind a fault that hides them are not made."""
    settings = patient.settings.jy901
    if settings.transport == "serial":
        switch_on = "plug the adapter in or switch the UART on (ls /dev/ttyUSB* /dev/serial*)"
        wanted = node.Node(PORT, Path(settings.port), "port in [jy901]", switch_on, "tty[UA][SCM]*")
        bad = node.examine(wanted, patient.user)
        if bad is not None and not (patient.taken and "in use" in bad.found):
            return [bad, not_checked(WHO, "it needs the serial port", "mend what stands above first")]
        if not patient.taken and (foreign := node.not_mine(wanted, patient.user, patient.me)) is not None:
            return [foreign]
    if patient.taken:
        return [not_checked(WHO, patient.taken, "stop the daemon to have it looked at")]
    return examine(patient, serial_opener(patient.settings, patient.clock, patient.support))


def examine(patient: Patient, open_port: Callable[[], SerialPort]) -> list[Check]:
    """As `look`, of a part behind this port."""
    settings = patient.settings.jy901
    patient.say("looking for the JY901 at all baud rates")
    # The doctor saves nothing in the part, whatever the configuration wants.
    read = read_for(settings.model_copy(update={"save": False}), patient, open_port)
    if read.identity is None:
        is_port = read.counters.port_failures > 0
        return [
            fault(
                PORT if is_port else WHO,
                read.condition.what,
                read.condition.advice if not is_port else "check the adapter, and port in [jy901]",
            ),
            not_checked(RATE, "the part does not deliver", "mend what stands above first"),
        ]
    section = "mount" if patient.settings.jy901.use == "instead" else "jy901_mount"
    axes = patient.settings.mount if section == "mount" else patient.settings.jy901_mount
    samples = [reading.sample() for reading in read.readings if not reading.is_frozen]
    return [
        ok(PORT, f"{settings.port if settings.transport == 'serial' else 'the virtual port'} opens"),
        judge_identity(read.identity, settings),
        judge_rate(read, settings),
        judge_dead_band(read.readings),
        *rest.examine(samples, rest.JY901, axes, section, "JY901 "),
    ]


def read_for(settings: Jy901Settings, patient: Patient, open_port: Callable[[], SerialPort]) -> Read:
    """Run the driver for as long as the doctor listens, from the first sample on."""
    clock = patient.clock
    sensor = Jy901(settings, clock, open_port)
    readings: list[Reading] = []
    end_ns = clock.now_ns() + round(_START_S * 1e9)
    driver = logging.getLogger("drivers")
    level = driver.level
    driver.setLevel(logging.CRITICAL)  # what it says stands in the checks
    try:
        while clock.now_ns() < end_ns and not (sensor.identity is None and sensor.counters.port_failures):
            got = [item for item in sensor.read_block() if isinstance(item, Reading)]
            if got and not readings:
                end_ns = clock.now_ns() + round(patient.listen_s * 1e9)
            readings += got
            if sensor.counters.failed_starts and not readings:
                break
    finally:
        sensor.close()
        driver.setLevel(level)
    return Read(readings, sensor.identity, sensor.counters, sensor.condition)


def judge_identity(who: Jy901Identity, settings: Jy901Settings) -> Check:
    """Found, and at which baud rate."""
    figures = {"firmware": who.firmware, "baud": who.baud}
    if who.baud == settings.baud:
        return ok(WHO, f"{who.name} answers at {who.baud} baud", **figures)
    return warning(
        WHO,
        f"{who.name} answers at {who.baud} baud and does not change to {settings.baud}",
        f"set baud = {who.baud} in [jy901]",
        **figures,
    )


def judge_rate(read: Read, settings: Jy901Settings) -> Check:
    """Whether it sends what it should, and whether that arrives."""
    count = len(read.readings)
    if count < rest.LEAST_SAMPLES:
        return fault(RATE, f"{count} samples came", read.condition.advice or "check the sensor's cable and its supply")
    seconds = (read.readings[-1].t_ns - read.readings[0].t_ns) * 1e-9
    rate_hz = (count - 1) / seconds
    lost = read.counters.lost
    figures = {"rate_hz": round(rate_hz, 2), "lost": lost, "bad_checksums": read.counters.bad_checksums}
    found = f"{rate_hz:.1f} samples a second of {settings.rate_hz} wanted, {lost} lost on the line"
    if any(reading.is_frozen for reading in read.readings):
        return fault(RATE, f"{found}; the samples stand still", "switch the sensor's supply off and on", **figures)
    if lost > _LOST_SHARE * (count + lost):
        return warning(RATE, found, "check the wires for length and contact, or set a lower baud in [jy901]", **figures)
    if rate_hz < _SLOW_SHARE * settings.rate_hz:
        return warning(RATE, found, "set a higher baud or bandwidth_hz in [jy901], or a lower rate_hz", **figures)
    return ok(RATE, found, **figures)


def judge_dead_band(readings: list[Reading]) -> Check:
    """Some firmware hides slow rates, and the bias with them."""
    zeros = sum(not any(reading.gyro[:3]) for reading in readings)
    if zeros > _DEAD_SHARE * len(readings):
        advice = "switch the dead band off with the vendor's program, or live without bias and heading"
        return warning(BAND, "the gyroscopes read exactly zero: slow rates are hidden, and with them the bias", advice)
    return ok(BAND, "the gyroscopes show their noise")
