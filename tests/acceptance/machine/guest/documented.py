"""The commands of docs/installation.md, run as they stand there."""

from __future__ import annotations

import os
import subprocess

from tests.acceptance.machine.guest.kit import HERE, SHARE

MANUAL = SHARE / "docs" / "installation.md"
_ENVIRONMENT = os.environ | {"PATH": f"{HERE / 'bin'}:{os.environ['PATH']}"}  # with a sudo


def attempt(command: str, changes: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """What came of a command that the manual shows, typed in the folder of the sources.

    Args:
        command: as it stands in a code block.
        changes: what the reader puts in the place of something.
    """
    assert command in _commands(), f"{MANUAL} has no command: {command}"
    for old, new in (changes or {}).items():
        assert old in command
        command = command.replace(old, new)
    return subprocess.run(
        ["sh", "-c", command], cwd=SHARE, env=_ENVIRONMENT, capture_output=True, text=True, check=False
    )


def documented(command: str, changes: dict[str, str] | None = None) -> str:
    """What it said; it must succeed."""
    ended = attempt(command, changes)
    assert ended.returncode == 0, f"{command}: {ended.returncode}\n{ended.stdout}{ended.stderr}"
    return ended.stdout


def _commands() -> list[str]:
    """Lines of all code blocks."""
    lines, is_code = [], False
    for line in MANUAL.read_text().splitlines():
        if line.startswith("```"):
            is_code = not is_code
        elif is_code:
            lines.append(line)
    return lines
