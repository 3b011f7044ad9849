"""Which errors are a user's, and how they are told: one sentence each, never a traceback."""

from __future__ import annotations

from daemon.configuration import ConfigurationError
from daemon.extras import needs
from daemon.recording.errors import RecordingError
from drivers.adis16448.device import ImuError
from drivers.can.settings import CanConfigError

FAILED, MISUSED = 1, 2
OFFLINE = ("scipy", "sklearn", "matplotlib", "plotly", "tomlkit")  # of the extra `offline`


class CommandError(Exception):
    """A command cannot do its work; the text is one sentence."""


class UsageError(CommandError):
    """A command cannot be used like that; the text is one sentence."""


def describe(error: Exception) -> tuple[int, list[str]] | None:
    """Exit code and sentences for an error that a person can mend; None for a fault of the program."""
    if isinstance(error, ConfigurationError):
        return MISUSED, error.sentences
    if isinstance(error, CanConfigError | UsageError):
        return MISUSED, [str(error)]
    if isinstance(error, RecordingError | CommandError | ImuError):
        return FAILED, [str(error)]
    if isinstance(error, ModuleNotFoundError) and (missing := (error.name or "").partition(".")[0]) in OFFLINE:
        return FAILED, [needs("this", f"the package {missing}", "offline")]
    if isinstance(error, OSError):
        name = f"{error.filename}: " if error.filename else ""
        return FAILED, [f"{name}{error.strerror or error}"]
    return None
