"""What is remembered over a restart, stroke and what was learned: a small JSON file, written atomically."""

from __future__ import annotations

import json
import logging
import os
import time
from math import hypot, sqrt
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from daemon.errors import UsageError
from daemon.machine import machine_of
from daemon.settings import Settings
from estimation.learned import DAY_S, Learned, prior_of
from estimation.pipeline import Start
from estimation.records import Estimate, Segment

FORMAT = 2
STROKE_ALONE = 1  # an older format, without what was learned
# What may have happened to the ram while nobody watched.
UNWATCHED_SIGMA_M = 0.005
UNWATCHED_PER_HOUR_M = 0.010
OVERSHOOT_MM = 50.0  # an estimate may lie a little beyond the stops
CLOCK_SLACK_S = 60.0
UNKNOWN_PAUSE_S = 7 * DAY_S  # a clock that went back cannot tell: few standstills last longer
LARGEST_FILE_BYTES = 100_000

_log = logging.getLogger(__name__)


class StateFileError(UsageError):
    """A state file cannot be used; the text is one sentence that names it."""


class SavedState(BaseModel):
    """Content of the file."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    format: int = FORMAT
    wall_time_s: float = Field(ge=0)
    stroke_mm: float = Field(gt=0)  # of the support it was saved for
    displacement_mm: float
    sigma_mm: float = Field(ge=0)
    at_rest: bool
    learned: Learned | None = None

    @classmethod
    def of(cls, last: Estimate, learned: Learned | None, stroke_mm: float, wall_time_s: float) -> SavedState:
        """After the estimate `last`."""
        return cls(
            wall_time_s=wall_time_s,
            stroke_mm=stroke_mm,
            displacement_mm=last.displacement_m * 1e3,
            sigma_mm=last.sigma_m * 1e3,
            at_rest=last.segment is Segment.ZUPT,
            learned=learned,
        )

    def start(self, settings: Settings, now_s: float) -> Start:
        """What it is still worth: the doubt grows with the time nobody watched."""
        unwatched_s = now_s - self.wall_time_s
        learned = self.learned
        if learned is not None:
            pause_s = unwatched_s if unwatched_s >= -CLOCK_SLACK_S else UNKNOWN_PAUSE_S
            learned = learned.inflated(pause_s, prior_of(settings.support, settings.estimator))
        sigma_m = hypot(self.sigma_mm / 1e3, UNWATCHED_SIGMA_M, UNWATCHED_PER_HOUR_M * unwatched_s / 3600)
        useless = None
        if not self.at_rest:
            useless = "was saved during a move"
        elif unwatched_s < -CLOCK_SLACK_S:
            useless = "was saved later than now, so the computer's clock is not to be trusted"
        elif sigma_m >= self.stroke_mm / 1e3 / sqrt(12.0):
            useless = "is too old or was too uncertain"
        if useless is not None:
            _log.warning("the saved stroke %s: the stroke is undetermined", useless)
            return Start(learned=learned)
        return Start(self.displacement_mm / 1e3, sigma_m, only_without_sensor=True, learned=learned)


def load(path: Path, settings: Settings, now_s: float | None = None) -> Start:
    """What is known from the last run; nothing, with the reason in the log, if the file is of no use."""
    try:
        saved = read(path, settings)
    except FileNotFoundError:
        return Start()
    except StateFileError as error:
        _log.warning("%s: the stroke is undetermined and nothing is learned yet", error)
        _set_aside(path)
        return Start()
    return saved.start(settings, time.time() if now_s is None else now_s)


def _set_aside(path: Path) -> None:
    """Keep a refused file from being saved over: one wrong setting must not cost months of learning."""
    aside = path.with_name(f"{path.name}.refused")
    try:
        if path.is_file() and not aside.exists():
            path.replace(aside)
    except OSError as error:
        _log.warning("%s cannot be kept as %s (%s)", path, aside.name, error.strerror)


def read(path: Path, settings: Settings) -> SavedState:
    """The file, all of it or nothing.

    Raises:
        FileNotFoundError: there is none.
        StateFileError: it is damaged, of another version or of another machine than that of the settings.
    """
    try:
        if path.is_fifo():
            raise StateFileError(f"{path} is a pipe, no file")  # opening it would wait for ever
        with path.open("rb") as stream:
            saved = SavedState.model_validate_json(stream.read(LARGEST_FILE_BYTES))
    except FileNotFoundError:
        raise
    except OSError as error:
        raise StateFileError(f"{path} cannot be read ({error.strerror})") from error
    except ValidationError as error:
        raise StateFileError(f"{path} is damaged or of another version") from error
    stroke_mm = settings.support.stroke_mm
    if saved.format not in (FORMAT, STROKE_ALONE):
        raise StateFileError(f"{path} is of another version (format {saved.format}, not {FORMAT})")
    if saved.stroke_mm != stroke_mm:
        raise StateFileError(
            f"{path} is of another machine: its stroke is {saved.stroke_mm:g} mm, not {stroke_mm:g} mm"
        )
    if not -OVERSHOOT_MM <= saved.displacement_mm <= stroke_mm + OVERSHOOT_MM:
        raise StateFileError(f"{path} holds an impossible stroke")
    if saved.learned is not None:
        try:
            saved.learned.check(machine_of(settings), prior_of(settings.support, settings.estimator))
        except ValueError as error:
            raise StateFileError(f"{path} cannot be used: {error}") from error
    return saved


def save(path: Path, saved: SavedState) -> None:
    """Replace the file: a power cut leaves the old or the new one, never half of one. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    try:
        with part.open("w") as stream:
            json.dump(saved.model_dump(), stream)
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
