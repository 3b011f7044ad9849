"""The computer: clock, real time, processors, heat and supply."""

from __future__ import annotations

import os
import resource
import subprocess
import time
from datetime import UTC, datetime
from pathlib import Path

from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, not_checked, ok, warning
from daemon.doctor.unit import Unit
from drivers.adis16448.configuration import ImuSettings

CLOCK, SYNCHRONISED, REAL_TIME, PROCESSORS, SUPPLY = (
    "clock",
    "time synchronisation",
    "real-time priority",
    "processors",
    "supply and heat",
)
_FIRST_YEAR, _LAST_YEAR = 2025, 2100
_COARSE_S = 1e-6
_CAP_SYS_NICE = 23  # linux/capability.h
_TIMESYNC = Path("/run/systemd/timesync/synchronized")
_GOVERNORS = "/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"
_THROTTLED = Path("/sys/devices/platform/soc/soc:firmware/get_throttled")  # Raspberry Pi
_THROTTLE_BITS = {0: "under-voltage", 1: "capped frequency", 2: "throttled", 3: "near the temperature limit"}
_SINCE_START = 16  # the same bits for what happened since the start


def look(patient: Patient) -> list[Check]:
    """All of the computer's part."""
    imu, unit = patient.settings.imu, patient.unit
    return [
        judge_clock(datetime.now(UTC), time.clock_getres(time.CLOCK_MONOTONIC)),
        judge_synchronised(is_synchronised()),
        judge_real_time(imu.realtime_priority, *_allowed(unit)),
        judge_processors(imu, os.cpu_count() or 1, _governors()),
        judge_supply(_throttled()),
    ]


def judge_clock(now: datetime, resolution_s: float) -> Check:
    """Wall clock and the resolution of the monotonic one."""
    figures = {"utc": now.isoformat(timespec="seconds"), "monotonic_resolution_s": resolution_s}
    found = f"{now:%Y-%m-%d %H:%M} UTC, monotonic clock in steps of {resolution_s * 1e9:g} ns"
    if not _FIRST_YEAR <= now.year <= _LAST_YEAR:
        advice = "set the clock, or fit a battery to the computer's: names and ages of recordings come from it"
        return warning(CLOCK, found, advice, **figures)
    if resolution_s > _COARSE_S:
        return warning(CLOCK, found, "use a kernel with high-resolution timers: samples are 1.2 ms apart", **figures)
    return ok(CLOCK, found, **figures)


def is_synchronised() -> bool | None:
    """By timedatectl, else by the mark that systemd-timesyncd leaves; None: nobody tells."""
    command = ["timedatectl", "show", "--property=NTPSynchronized", "--value"]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=True)
    except (OSError, subprocess.SubprocessError):
        return True if _TIMESYNC.exists() else None
    return {"yes": True, "no": False}.get(ended.stdout.strip())


def judge_synchronised(is_so: bool | None) -> Check:
    """A wrong date spoils names, not estimates."""
    if is_so is None:
        return not_checked(SYNCHRONISED, "nobody tells: neither timedatectl nor systemd-timesyncd is here")
    if is_so:
        return ok(SYNCHRONISED, "the clock follows a time server")
    advice = "sudo timedatectl set-ntp true, or live with file names and ages by the computer's own clock"
    return warning(SYNCHRONISED, "the clock follows no time server", advice)


def judge_real_time(priority: int | None, limit: int, has_capability: bool, whose: str) -> Check:
    """Whether `realtime_priority` would be granted."""
    if priority is None:
        return ok(REAL_TIME, "none is asked for")
    figures = {"wanted": priority, "limit": limit, "cap_sys_nice": has_capability}
    if has_capability or limit >= priority:
        return ok(REAL_TIME, f"realtime_priority = {priority} is allowed to {whose}", **figures)
    advice = f"set LimitRTPRIO={priority} in the service unit, or rtprio for the user in /etc/security/limits.conf"
    found = f"realtime_priority = {priority} will be refused: {whose} may have up to {limit}"
    return warning(REAL_TIME, found, advice, **figures)


def judge_processors(imu: ImuSettings, count: int, governors: set[str]) -> Check:
    """Enough of them, and not asleep."""
    figures = {"processors": count, "governors": sorted(governors)}
    found = f"{count} processor{'s' if count > 1 else ''}, governor {' and '.join(sorted(governors)) or 'not known'}"
    if imu.acquisition == "process" and count < 2:
        advice = 'set acquisition = "thread" in [imu]: a process of its own needs a processor of its own'
        return warning(PROCESSORS, f'{found}; acquisition = "process"', advice, **figures)
    if "powersave" in governors:
        advice = "set the governor to ondemand, schedutil or performance: reads come late on a slow processor"
        return warning(PROCESSORS, found, advice, **figures)
    return ok(PROCESSORS, found, **figures)


def judge_supply(bits: int | None) -> Check:
    """What a Raspberry Pi's firmware has to say; `bits` as its throttled word."""
    if bits is None:
        return not_checked(SUPPLY, "this computer does not tell of under-voltage and throttling")
    now = [word for bit, word in _THROTTLE_BITS.items() if bits >> bit & 1]
    past = [word for bit, word in _THROTTLE_BITS.items() if bits >> bit + _SINCE_START & 1]
    if not now and not past:
        return ok(SUPPLY, "no under-voltage, no throttling since the start", throttled=bits)
    found = f"now {' and '.join(now) or 'nothing'}, since the start {' and '.join(past) or 'nothing'}"
    advice = "use a stronger supply and a shorter cable" if (bits | bits >> _SINCE_START) & 1 else "cool the computer"
    return warning(SUPPLY, found, advice, throttled=bits)


def _allowed(unit: Unit | str) -> tuple[int, bool, str]:
    """Highest priority, whether a capability grants any, and to whom."""
    if isinstance(unit, Unit) and unit.is_installed:
        return unit.realtime_limit, unit.user == "root", "the service"
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    status = Path("/proc/self/status").read_text()
    granted = next((line.split()[1] for line in status.splitlines() if line.startswith("CapEff:")), "0")
    return 99 if limit < 0 else limit, bool(int(granted, 16) >> _CAP_SYS_NICE & 1), "who asks"


def _governors() -> set[str]:
    found = set()
    for path in Path("/").glob(_GOVERNORS.lstrip("/")):
        try:
            found.add(path.read_text().strip())
        except OSError:
            continue
    return found


def _throttled() -> int | None:
    try:
        return int(_THROTTLED.read_text(), 16)
    except (OSError, ValueError):
        return None
