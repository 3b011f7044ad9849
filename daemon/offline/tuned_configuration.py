"""Tuned values into a configuration file, with where they come from; what else stands in the file stays as it is."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from daemon.configuration import load
from daemon.errors import UsageError
from daemon.offline.tuning_recordings import fingerprint
from daemon.recording.metadata import program_version
from daemon.settings import Settings

MARK = "tuned by ramstroke tune"


def save(
    path: Path, values: dict[str, dict[str, Any]], settings: Settings, files: Sequence[Path], row: dict[str, Any]
) -> None:
    """Put the values (section -> key -> value) into the file, made from `settings` if there is none.

    Written beside it and moved into place once it has been read back as a good configuration. Raises UsageError, or
    ConfigurationError where the file as it stands is none.
    """
    if path.exists():
        load(path)  # refuse to write into what is no good configuration
        document = tomlkit.parse(path.read_text(encoding="utf-8"))
    else:
        plain = json.loads(settings.model_dump_json(exclude_none=True))
        document = tomlkit.parse(tomlkit.dumps(plain))
    try:
        for section, keys in values.items():
            table = document.setdefault(section, tomlkit.table())
            origin = _origin(files, row)
            for key, value in keys.items():
                said = (
                    table[key].trivia.comment.removeprefix("#").partition(MARK)[0].rstrip("; ") if key in table else ""
                )
                table[key] = _number(value)
                if comment := "; ".join(part for part in (said.strip(), origin) if part):
                    table[key].comment(comment)
                origin = ""  # once is enough
        text = tomlkit.dumps(document)
    except TOMLKitError as error:
        raise UsageError(f"--save {path}: {error}") from error
    draft = path.with_name(path.name + ".new")
    try:
        draft.write_text(text, encoding="utf-8")
        load(draft)
        os.replace(draft, path)
    except OSError as error:
        raise UsageError(f"--save {path}: {error.strerror}; name a file in a folder that can be written") from error
    finally:
        draft.unlink(missing_ok=True)


def _origin(files: Sequence[Path], row: dict[str, Any]) -> str:
    """Where the values come from, for a comment."""
    spread = row.get("log10_ratio_low"), row.get("log10_ratio_high")
    interval = "" if None in spread else f", log10(q/r) {spread[0]:.2f} to {spread[1]:.2f} (3 sigma)"
    return (
        f"{MARK} {program_version()}, {datetime.now(UTC):%Y-%m-%d}: method {row['method']}, objective "
        f"{row['objective']}, seed {row['seed']}, {row['evaluations']} evaluations{interval}; "
        f"{', '.join(file.name for file in files)} (SHA-256 {fingerprint(files)[:16]})"
    )


def _number(value: Any) -> Any:
    """Six digits: more the data never tell."""
    return float(f"{value:.6g}") if isinstance(value, float) else value
