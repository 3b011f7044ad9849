"""What the daemon would remember of its last run."""

from __future__ import annotations

import time

from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, elsewhere, ok, warning
from daemon.service.state_file import CLOCK_SLACK_S, SavedState, StateFileError, read
from daemon.settings import Settings

NAME = "learned state"
_HOUR_S, _DAY_S = 3600.0, 86_400.0


def look(patient: Patient) -> list[Check]:
    """The state file."""
    path = patient.settings.service.state_file
    try:
        return [judge(read(path, patient.settings), patient.settings, time.time())]
    except FileNotFoundError:
        return [ok(NAME, f"there is no {path} yet: nothing is learned, as before a first start")]
    except StateFileError as error:
        if not patient.user.is_me and isinstance(error.__cause__, PermissionError):
            return [elsewhere(NAME, str(error), patient.user.name)]
        advice = (
            "correct stroke_mm in [support] if that is wrong, else let the daemon set the file aside and learn anew"
        )
        return [warning(NAME, str(error), advice)]


def judge(saved: SavedState, settings: Settings, now_s: float) -> Check:
    """Age, stroke, and how many moves were learned from."""
    age_s = now_s - saved.wall_time_s
    moves = 0 if saved.learned is None else saved.learned.push.moves + saved.learned.retract.moves
    figures = {"age_s": round(age_s), "displacement_mm": saved.displacement_mm, "moves_learned": moves}
    age = f"{age_s:.0f} s" if age_s < _HOUR_S else f"{age_s / _HOUR_S:.1f} h"
    if age_s > _DAY_S:
        age = f"{age_s / _DAY_S:.1f} days"
    found = f"of this machine ({settings.support.stroke_mm:g} mm), {age} old: {saved.displacement_mm:.1f} mm, {moves} "
    found += "moves learned from"
    if age_s < -CLOCK_SLACK_S:
        return warning(NAME, f"{found}; it was saved later than now", "set the computer's clock", **figures)
    return ok(NAME, found, **figures)
