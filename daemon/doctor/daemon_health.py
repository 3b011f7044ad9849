"""The running daemon: is there one on this configuration, and what does it say of its parts?"""

from __future__ import annotations

from typing import Any

from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, Verdict, not_checked, ok

NAME = "daemon"
PARTS = ("imu", "jy901", "can", "displacement", "estimator", "recorder", "loop")
_VERDICTS = {"ok": Verdict.OK, "ill": Verdict.WARNING, "waiting": Verdict.FAULT}


def look(patient: Patient) -> list[Check]:
    """Whether it runs; if so the devices are its own, and its word counts."""
    status, socket = patient.status, patient.settings.service.socket
    if status is not None:
        found = (
            f"version {status['version']} runs and answers on {socket}: the sensors are its own, and its word counts"
        )
        return [ok(NAME, found, running=True), *(judge(part, status[part]) for part in _told(status))]
    if patient.taken:
        advice = f"stop it, or ask as a member of the group of {socket}, to have the devices looked at"
        return [not_checked(NAME, patient.taken, advice, running=None)]
    return [ok(NAME, "none runs on this configuration: the devices are free to be looked at", running=False)]


def judge(part: str, health: dict[str, Any]) -> Check:
    """A part by its health record."""
    verdict = _VERDICTS.get(str(health["state"]), Verdict.NOT_CHECKED)
    name = f"{NAME}: {part}"
    if verdict is Verdict.OK:
        return ok(name, "well, says the daemon")
    return Check(name, verdict, str(health["what"]), str(health["advice"]) or "see `ramstroke status`")


def _told(status: dict[str, Any]) -> list[str]:
    return [part for part in PARTS if part in status and status[part]["state"] != "off"]
