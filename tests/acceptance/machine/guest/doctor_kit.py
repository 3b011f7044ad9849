"""What `ramstroke doctor` says of a set-up, as a person and as a program read it."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.acceptance.machine.guest.kit import CONFIG, RAMSTROKE, RESULTS

FOLDER = RESULTS / "doctor"
TABLE = FOLDER / "set-ups.jsonl"
CHANGED = Path("/etc/ramstroke/changed.toml")
MEND, BETTER = "To mend, the first one first:", "Better:"


@dataclass(frozen=True)
class Seen:
    """One look."""

    code: int
    text: str


def look(name: str, *, user: str = "root") -> Seen:
    """Run the installed program."""
    command = ["runuser", "-u", user, "--", RAMSTROKE, "doctor"]
    if CHANGED.exists():
        command += ["--config", str(CHANGED)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / (name.replace("/", "_") + ".txt")).write_text(f"exit {ended.returncode}\n{ended.stdout}{ended.stderr}")
    return Seen(ended.returncode, f"##### {name} exit {ended.returncode}\n{ended.stdout}{ended.stderr}")


@contextmanager
def changed(old: str, new: str) -> Iterator[None]:
    text = CONFIG.read_text()
    assert old in text
    CONFIG.write_text(text.replace(old, new))
    try:
        yield
    finally:
        CONFIG.write_text(text)
