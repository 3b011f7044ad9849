"""The rest of a sensor that the running daemon reads: taken from the recording that it writes meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from daemon.errors import CommandError
from daemon.imu.roles import Role
from daemon.offline.alignment.rest import Rest, rests_since
from daemon.service.live_client import first_line

_SLICE_S = 0.5
_WRITTEN_S = 1.0  # until what was measured is in the file


def live_rests(socket: Path, seconds: float, progress: Callable[[float], None]) -> tuple[Path, dict[Role, Rest]]:
    """Wait so long, then read what the daemon has recorded meanwhile; the recording, and the rests.

    Raises CommandError: no daemon answers, it records nothing, or it began another file; RecordingError: no rest.
    """
    greeting = first_line(socket)
    name = greeting["recorder"]["file"]
    if not name:
        raise CommandError("the daemon records nothing: set enabled = true in [recording], or see `ramstroke status`")
    from_ns = round(greeting["t_s"] * 1e9)
    began_s = time.monotonic()
    while (waited_s := time.monotonic() - began_s) < seconds + _WRITTEN_S:
        progress(min(waited_s, seconds))
        time.sleep(_SLICE_S)
    if first_line(socket)["recorder"]["file"] != name:
        raise CommandError("the daemon has begun another recording meanwhile: try again")
    return Path(name), rests_since(Path(name), from_ns, seconds)
