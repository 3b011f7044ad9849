"""What the doctor looks at, and what all checks need to know."""

from __future__ import annotations

import errno
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daemon.doctor.rights import User, named_user, this_user
from daemon.doctor.unit import Unit, read_unit
from daemon.errors import CommandError
from daemon.service.live_client import first_line
from daemon.settings import Settings
from drivers.clock import Clock, SystemClock

if TYPE_CHECKING:
    from drivers.virtual.support import VirtualSupport

LISTEN_S = 3.0


@dataclass(slots=True)
class Patient:
    """One configuration on one computer at one moment."""

    settings: Settings
    file: Path | None  # None: all defaults
    unit: Unit | str  # or why nothing is known of it
    status: dict[str, Any] | None = None  # the greeting of the daemon that runs on this configuration
    no_status: str = ""  # why there is none, if that leaves open whether a daemon runs
    clock: Clock = field(default_factory=SystemClock)
    say: Callable[[str], None] = lambda _: None  # what is being done
    scan_lines: bool = False  # watch the other lines of the GPIO chip too, if the configured one is silent
    me: User = field(default_factory=this_user)
    support: VirtualSupport | None = None  # that carries virtual sensors of this process
    listen_s: float = LISTEN_S

    @property
    def user(self) -> User:
        """Whom the rights must suit: the service's user, or who asks if there is no service."""
        if isinstance(self.unit, Unit) and self.unit.is_installed:
            return named_user(self.unit.user) or self.me
        return self.me

    @property
    def taken(self) -> str:
        """Why the devices are not to be touched; empty if they may be."""
        if self.status is not None:
            return "it belongs to the running daemon"
        if isinstance(self.unit, Unit) and self.unit.is_active:
            return "the service runs, though not on this configuration's socket, and may be using it"
        return f"a daemon may be running: {self.no_status}" if self.no_status else ""


def _nobody_listens(error: CommandError) -> bool:
    """Whether the socket is missing, or left over by a daemon that is gone: others may hang, or be nobody's to ask."""
    cause = error.__cause__
    if not isinstance(cause, OSError) or isinstance(cause, TimeoutError):
        return False
    return cause.errno in (None, errno.ENOENT, errno.ECONNREFUSED)


def admit(
    settings: Settings, file: Path | None, *, say: Callable[[str], None] = lambda _: None, scan_lines: bool = False
) -> Patient:
    """Find out who runs, and make a virtual support if the configuration wants one."""
    patient = Patient(settings, file, read_unit(), say=say, scan_lines=scan_lines)
    try:
        patient.status = first_line(settings.service.socket)
    except CommandError as error:
        patient.no_status = "" if _nobody_listens(error) else str(error)
    if settings.needs_support and patient.status is None:
        from daemon.simulation.virtual import virtual_support

        patient.support = virtual_support(settings, start_ns=patient.clock.now_ns())
    return patient
