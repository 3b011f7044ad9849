"""One look at one thing: what was found, how bad that is, and what to do about it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

ASK_AS = "sudo -u"
NOTHING = "nothing to do"


class Verdict(StrEnum):
    """How bad it is."""

    OK = "ok"
    NOT_CHECKED = "not checked"
    WARNING = "warning"
    FAULT = "fault"


_ORDER = tuple(Verdict)


@dataclass(slots=True, frozen=True)
class Check:
    """What was found and what to do are a sentence each; figures have their unit in the name."""

    name: str
    verdict: Verdict
    found: str
    advice: str = NOTHING
    figures: dict[str, Any] = field(default_factory=dict)
    follows_from: str = ""  # the check whose fault, once mended, may take this one along

    def row(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "name": self.name,
            "verdict": str(self.verdict),
            "found": self.found,
            "advice": self.advice,
            **({"follows_from": self.follows_from} if self.follows_from else {}),
            **self.figures,
        }


def ok(name: str, found: str, **figures: Any) -> Check:
    """All is well."""
    return Check(name, Verdict.OK, found, figures=figures)


def warning(name: str, found: str, advice: str, **figures: Any) -> Check:
    """It works, but better not so."""
    return Check(name, Verdict.WARNING, found, advice, figures)


def fault(name: str, found: str, advice: str, **figures: Any) -> Check:
    """It cannot work like that."""
    return Check(name, Verdict.FAULT, found, advice, figures)


def not_checked(name: str, why: str, advice: str = NOTHING, **figures: Any) -> Check:
    """It could not be looked at."""
    return Check(name, Verdict.NOT_CHECKED, why, advice, figures)


def elsewhere(name: str, why: str, user: str) -> Check:
    """Only that user may look."""
    return not_checked(name, why, f"{ASK_AS} {user} ramstroke doctor")


def worst(checks: Iterable[Check]) -> Verdict:
    """The worst verdict of all."""
    return max((check.verdict for check in checks), key=_ORDER.index, default=Verdict.OK)


def guarded(area: str, look: Callable[[], list[Check]]) -> list[Check]:
    """The checks of one area; what goes wrong while it is looked at hides no other area."""
    try:
        return look()
    except Exception as error:
        return [not_checked(area, f"a fault of the program ({type(error).__name__}: {error})", "report it")]
