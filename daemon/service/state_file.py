"""The stroke, remembered over a restart: a small JSON file, written atomically."""

from __future__ import annotations

import json
import logging
import os
import time
from math import hypot, sqrt
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from estimation.pipeline import Start

FORMAT = 1
# What may have happened to the ram while nobody watched.
UNWATCHED_SIGMA_M = 0.005
UNWATCHED_PER_HOUR_M = 0.010
OVERSHOOT_MM = 50.0  # an estimate may lie a little beyond the stops
CLOCK_SLACK_S = 60.0
LARGEST_FILE_BYTES = 100_000

_log = logging.getLogger(__name__)


class SavedStroke(BaseModel):
    """Content of the file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: int = FORMAT
    wall_time_s: float = Field(ge=0, allow_inf_nan=False)
    stroke_mm: float = Field(gt=0, allow_inf_nan=False)  # of the support it was saved for
    displacement_mm: float = Field(allow_inf_nan=False)
    sigma_mm: float = Field(ge=0, allow_inf_nan=False)
    at_rest: bool

    def start(self, now_s: float) -> Start:
        """What it is still worth: the doubt grows with the time nobody watched. Undetermined if nothing."""
        unwatched_s = now_s - self.wall_time_s
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
            return Start()
        return Start(self.displacement_mm / 1e3, sigma_m, only_without_sensor=True)


def load(path: Path, stroke_mm: float, now_s: float | None = None) -> Start:
    """What is known from the last run; undetermined, with the reason in the log, if the file is of no use."""
    try:
        with path.open("rb") as stream:
            saved = SavedStroke.model_validate_json(stream.read(LARGEST_FILE_BYTES))
    except FileNotFoundError:
        return Start()
    except OSError as error:
        _log.warning("%s cannot be read (%s): the stroke is undetermined", path, error.strerror)
        return Start()
    except ValidationError:
        _log.warning("%s is damaged or of another version: the stroke is undetermined", path)
        return Start()
    if saved.format != FORMAT or saved.stroke_mm != stroke_mm:
        _log.warning("%s was saved for another support or version: the stroke is undetermined", path)
        return Start()
    if not -OVERSHOOT_MM <= saved.displacement_mm <= stroke_mm + OVERSHOOT_MM:
        _log.warning("%s holds an impossible stroke: the stroke is undetermined", path)
        return Start()
    return saved.start(time.time() if now_s is None else now_s)


def save(path: Path, saved: SavedStroke) -> None:
    """Replace the file: a power cut leaves the old or the new one, never half of one. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    with part.open("w") as stream:
        json.dump(saved.model_dump(), stream)
        stream.flush()
        os.fsync(stream.fileno())
    part.replace(path)
