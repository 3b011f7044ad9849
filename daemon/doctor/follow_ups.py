"""One fault, one thing to mend: what follows from a fault is told, but is nothing to mend of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from daemon.doctor import can, can_link, can_traffic, daemon_health, disk
from daemon.doctor.report import Check, Verdict

_BUS = (can_link.INTERFACE, can_link.CONTROLLER, can_traffic.FRAMES, can.DISPLACEMENT)
_CAN, _VALUE, _IMU = (f"{daemon_health.NAME}: {part}" for part in ("can", "displacement", "imu"))
# What the running daemon feels of a fault that is looked at more closely elsewhere, and of one in another part of it.
_CAUSES: dict[str, Sequence[str]] = {
    _CAN: _BUS,
    _VALUE: (*_BUS, _CAN),
    f"{daemon_health.NAME}: estimator": (*_BUS, _IMU, _CAN, _VALUE),
    f"{daemon_health.NAME}: recorder": (disk.FOLDER, disk.SPACE, disk.SPEED),
}


def marked(checks: Sequence[Check]) -> list[Check]:
    """The same checks; those that follow from another one's fault, or want the same done, say from which."""
    faults = [check for check in checks if check.verdict is Verdict.FAULT]
    return [replace(check, follows_from=_cause(check, faults)) for check in checks]


def _cause(check: Check, faults: Sequence[Check]) -> str:
    if check.verdict not in (Verdict.FAULT, Verdict.WARNING):
        return ""
    for other in faults:
        if other is check:
            break
        if other.advice == check.advice:
            return other.name
    return next((other.name for other in faults if other.name in _CAUSES.get(check.name, ())), "")
