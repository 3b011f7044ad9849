"""Reading the daemon's Unix socket."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

from daemon.errors import CommandError

TIMEOUT_S = 5.0


def first_line(path: Path) -> dict[str, Any]:
    """The greeting of the daemon, which holds its whole status. Raises CommandError."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as channel:
            channel.settimeout(TIMEOUT_S)
            channel.connect(str(path))
            with channel.makefile("rb") as lines:
                line = lines.readline(1_000_000)
    except OSError as error:
        raise CommandError(
            f"no daemon answers on {path} ({error.strerror or error}): start `ramstroke run`, "
            "or name its configuration with --config"
        ) from error
    try:
        greeting = json.loads(line)
    except ValueError as error:
        raise CommandError(f"what answers on {path} is no ramstroke daemon") from error
    if isinstance(greeting, dict) and greeting.get("type") == "refused":
        raise CommandError(f"the daemon on {path} serves as many viewers as it can: close one of them")
    if not isinstance(greeting, dict) or greeting.get("type") != "hello":
        raise CommandError(f"what answers on {path} is no ramstroke daemon")
    return greeting
