"""All areas in the order in which the first fault is the one to mend first."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from daemon.doctor import adis16448, can, daemon_health, disk, follow_ups, jy901, machine, memory, program, service
from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, guarded

Look = Callable[[Patient], list[Check]]


def examine(patient: Patient) -> list[Check]:
    """Every check; what goes wrong in one area hides no other."""
    areas: list[tuple[str, Look]] = [("program", program.look), ("daemon", daemon_health.look)]
    if patient.settings.jy901.use != "instead":
        areas.append(("inertial sensor", adis16448.look))
    if patient.settings.jy901.use != "no":
        areas.append(("JY901", jy901.look))
    areas += [
        ("CAN", can.look),
        ("disk", disk.look),
        ("computer", machine.look),
        ("service", service.look),
        ("learned state", memory.look),
    ]
    checks: list[Check] = []
    for area, look in areas:
        patient.say(f"looking at {area}")
        checks += guarded(area, partial(look, patient))
    return follow_ups.marked(checks)
