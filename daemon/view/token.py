"""The secret that a browser elsewhere must know."""

from __future__ import annotations

import secrets
from pathlib import Path

from daemon.errors import UsageError

SHORTEST = 16


def read(path: Path) -> str:
    """The one line of the file. Raises UsageError."""
    try:
        token = path.read_text(encoding="ascii").strip()
    except OSError as error:
        raise UsageError(f"--token-file {path} cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"--token-file {path}: the token must be plain letters and digits") from error
    if len(token) < SHORTEST or not all(c.isalnum() or c in "-_" for c in token):
        raise UsageError(
            f"--token-file {path}: the token must be one line of at least {SHORTEST} letters, digits, - and _, "
            "such as `openssl rand -hex 16` makes"
        )
    if path.stat().st_mode & 0o007:
        raise UsageError(f"--token-file {path} can be read by everybody: chmod o= {path}")
    return token


def made() -> str:
    """A new one."""
    return secrets.token_urlsafe(24)
