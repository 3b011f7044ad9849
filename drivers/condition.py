"""How a part of the program or a device is, in words for people."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Wellness(StrEnum):
    """One word for a glance."""

    OK = "ok"
    ILL = "ill"  # works, but not as it should
    WAITING = "waiting"  # does not work now; the program keeps trying
    OFF = "off"  # not wanted


@dataclass(slots=True, frozen=True)
class Condition:
    """A word, one sentence that says what is wrong, one that says what to do; both empty while all is well."""

    word: Wellness
    what: str = ""
    advice: str = ""


OK = Condition(Wellness.OK)
OFF = Condition(Wellness.OFF)
