"""Which sensor does what."""

from __future__ import annotations

from typing import Literal

from daemon.settings import Settings

Role = Literal["main", "beside"]  # estimated from; recorded beside it


def is_jy901(settings: Settings, role: Role) -> bool:
    """Whether the sensor of that role is a JY901; one beside always is."""
    return role == "beside" or settings.jy901.use == "instead"
