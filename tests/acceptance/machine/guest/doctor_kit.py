"""What `ramstroke doctor` says of a set-up, as a person reads it."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import dataclass

from tests.acceptance.machine.guest.kit import RAMSTROKE, RESULTS

TABLE = RESULTS / "doctor.jsonl"
TEXTS = RESULTS / "doctor"
_MEND, _BETTER = "To mend, the first one first:", "Better:"
_ADVICE = re.compile(r"  \d+\. ([^:]+(?:: \w+)?): (.+)")  # `daemon: can` is the name of one check


@dataclass(frozen=True)
class Seen:
    """One look: exit code, and what to do about whom, the first thing first."""

    code: int
    mend: list[tuple[str, str]]
    better: list[tuple[str, str]]
    text: str


def look(set_up: str, *, user: str = "root") -> Seen:
    """Run the installed program, and keep what it says for the report on the host."""
    command = ["runuser", "-u", user, "--", RAMSTROKE, "doctor"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    TEXTS.mkdir(parents=True, exist_ok=True)
    (TEXTS / f"{set_up}.txt").write_text(ended.stdout + ended.stderr)
    _, _, to_do = ended.stdout.partition("┘\n")
    mend, _, better = to_do.partition(_BETTER)
    with TABLE.open("a") as table:
        row = {"set_up": set_up, "code": ended.returncode, "to_do": (to_do or ended.stderr).splitlines()}
        table.write(json.dumps(row) + "\n")
    assert (_MEND in mend) == (ended.returncode == 1), ended.stdout + ended.stderr
    return Seen(ended.returncode, _ADVICE.findall(mend), _ADVICE.findall(better), ended.stdout + ended.stderr)
