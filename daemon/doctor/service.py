"""The service: installed, enabled, running, on this configuration, and with the rights that it needs."""

from __future__ import annotations

from pathlib import Path

from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, fault, not_checked, ok, warning
from daemon.doctor.rights import INSTALL, READ, WRITE, groups_to_join, named_user
from daemon.doctor.unit import Unit
from daemon.errors import CommandError
from daemon.service.installer import fitted
from daemon.settings import Settings

NAME, FILE, CONFIGURATION, RIGHTS = "service", "service's unit", "service's configuration", "service's rights"
_MANY_RESTARTS = 3


def look(patient: Patient) -> list[Check]:
    """All of the unit."""
    unit = patient.unit
    if isinstance(unit, str):
        return [not_checked(NAME, unit, "start `ramstroke run` by another supervisor, which starts it again")]
    if not unit.is_installed:
        found = "ramstroke.service is not installed: nothing starts the daemon"
        return [warning(NAME, found, f"{INSTALL} --start, once nothing is at fault here")]
    return [
        judge_unit(unit),
        judge_file(unit),
        judge_configuration(unit, patient.file),
        judge_rights(unit, patient.settings),
    ]


def judge_unit(unit: Unit) -> Check:
    """Whether it runs now and will after a restart."""
    figures = {
        "state": unit.state,
        "enabled": unit.is_enabled,
        "restarts": unit.restarts,
        "watchdog": unit.has_watchdog,
    }
    found = f"{unit.state}, {'' if unit.is_enabled else 'not '}enabled, {unit.restarts} restarts"
    if unit.state == "failed":
        advice = "journalctl -u ramstroke -n 50 says why; mend that, then sudo systemctl restart ramstroke"
        return fault(NAME, f"{found}: it ended with {unit.result}", advice, **figures)
    # Systemd tells the watchdog of a unit only once that has been started.
    if unit.is_active and not unit.has_watchdog:
        advice = "set WatchdogSec=10 in [Service] of the unit or of the drop-in that changes it, then sudo systemctl "
        found = f"{found}; no watchdog ends a daemon that hangs"
        return warning(NAME, found, f"{advice}daemon-reload (systemctl cat ramstroke shows both)", **figures)
    if not unit.is_enabled:
        now = "" if unit.is_active else "--now "
        once = "" if unit.is_active else ", once nothing is at fault here"
        found = f"{found}: it does not start with the computer"
        return warning(NAME, found, f"sudo systemctl enable {now}ramstroke{once}", **figures)
    if not unit.is_active:
        return warning(NAME, found, "sudo systemctl start ramstroke, once nothing is at fault here", **figures)
    if unit.restarts >= _MANY_RESTARTS:
        return warning(NAME, found, "journalctl -u ramstroke says why it was started anew", **figures)
    return ok(NAME, found, **figures)


def judge_file(unit: Unit) -> Check:
    """Whether the unit's file is the one of this version; what `systemctl edit` adds is the user's right."""
    try:
        is_ours = unit.file is not None and unit.file.read_text(encoding="utf-8") == fitted("ramstroke.service")
    except (OSError, CommandError) as error:
        return not_checked(FILE, f"it cannot be compared: {error}")
    if is_ours:
        return ok(FILE, f"{unit.file} is that of this version")
    advice = f"{INSTALL} writes that of this version; changes of your own belong into `sudo systemctl edit ramstroke`"
    return warning(FILE, f"{unit.file} is of another version, or changed by hand", advice)


def judge_configuration(unit: Unit, file: Path | None) -> Check:
    """Whether what is looked at here is what the service uses."""
    theirs = str(unit.configuration) if unit.configuration else "no file, all defaults"
    mine = str(file) if file else "no file, all defaults"
    same = unit.configuration == file if None in (unit.configuration, file) else _same(unit.configuration, file)
    if same:
        return ok(CONFIGURATION, f"it uses {theirs}, as doctor does")
    advice = f"ramstroke doctor --config {theirs}, or correct ExecStart in the unit"
    return warning(CONFIGURATION, f"the service uses {theirs}, doctor looked at {mine}", advice)


def judge_rights(unit: Unit, settings: Settings) -> Check:
    """Whether the service's user may use the devices that exist."""
    user = named_user(unit.user)
    if user is None:
        advice = f"{INSTALL} makes it, or correct User= in the unit"
        return fault(RIGHTS, f"the unit's user {unit.user} does not exist", advice)
    devices = [path for path in devices_of(settings) if path.exists()]
    refused = [path for path in devices if not user.may(path, READ | WRITE)]
    if refused:
        words = " and ".join(map(str, refused))
        found = f"user {user.name} may not use {words}"
        return fault(RIGHTS, found, groups_to_join(user, devices), refused=[str(path) for path in refused])
    return ok(RIGHTS, f"user {user.name} may use {' and '.join(map(str, devices)) or 'all that is there: nothing'}")


def devices_of(settings: Settings) -> list[Path]:
    """Device files that the configuration names."""
    imu, jy901, found = settings.imu, settings.jy901, []
    if jy901.use != "instead" and imu.transport == "spidev":
        found.append(Path(imu.spi_device))
        if imu.data_ready_line is not None:
            found.append(Path(imu.data_ready_chip))
    if jy901.use != "no" and jy901.transport == "serial":
        found.append(Path(jy901.port))
    return found


def _same(one: Path | None, other: Path | None) -> bool:
    assert one is not None
    assert other is not None
    return one.resolve() == other.resolve()
