"""Settings of the recorder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

_Megabytes = Annotated[float, Field(gt=0, le=10_000_000)]
_Interval = Annotated[int, Field(ge=1, le=10_000)]


class RecorderSettings(BaseModel):
    """Where recordings go, how files are cut and how much disk they may take (1 MB = 10^6 bytes)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    directory: Path = Field(
        default=Path("/var/lib/ramstroke/recordings"), description="folder of the recordings, made if missing"
    )
    enabled: bool = Field(default=True, description="record at all; false keeps nothing")
    rotate_mb: _Megabytes = Field(default=256, description="begin a new file at this size [MB]")
    rotate_minutes: Annotated[float, Field(gt=0, le=10_080)] = Field(
        default=60, description="begin a new file after this time [min]"
    )
    budget_mb: _Megabytes = Field(
        default=4096, description="delete the oldest recordings beyond this total [MB], at least rotate_mb"
    )
    keep_free_mb: Annotated[float, Field(ge=0, le=10_000_000)] = Field(
        default=200, description="leave at least this much of the disk free [MB]"
    )
    flush_interval_ms: _Interval = Field(
        default=100, description="hand records to the kernel: the loss when the program is killed [ms]"
    )
    sync_interval_ms: _Interval = Field(
        default=1000, description="push records to the disk: the loss when the power is cut [ms]"
    )

    @model_validator(mode="after")
    def _budget_holds_a_file(self) -> Self:
        if self.budget_mb < self.rotate_mb:
            raise ValueError(
                f"budget_mb = {self.budget_mb:g} is smaller than one file (rotate_mb = {self.rotate_mb:g}): "
                "raise budget_mb or lower rotate_mb"
            )
        return self
