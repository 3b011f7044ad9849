"""Reading TOML files of people, and the words in which their faults are told."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_LARGEST_FILE_BYTES = 1_000_000
_UNITS = ("_mm_s", "_mm", "_ms", "_us", "_hz", "_dps", "_mb", "_minutes", "_samples", "_m", "_s", "_cm")


class ConfigurationError(Exception):
    """A file cannot be used; `sentences` say why, one each."""

    def __init__(self, sentences: list[str]) -> None:
        super().__init__("\n".join(sentences))
        self.sentences = sentences


def read_toml(path: Path, what: str) -> tuple[str, dict[str, Any]]:
    """Text and content of a TOML file that should be a `what`. Raises ConfigurationError."""
    try:
        with path.open("rb") as stream:
            data = stream.read(_LARGEST_FILE_BYTES + 1)
    except OSError as error:
        raise ConfigurationError([f"{path}: cannot be read: {error.strerror}"]) from error
    if len(data) > _LARGEST_FILE_BYTES:
        raise ConfigurationError([f"{path}: is larger than 1 MB and no {what}"])
    try:
        text = data.decode("utf-8-sig")  # some editors put a mark in front
        return text, tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise ConfigurationError([f"{path}: is no text file (UTF-8)"]) from error
    except (ValueError, RecursionError) as error:
        raise ConfigurationError([f"{path}: is not valid TOML: {error}"]) from error


def plain(message: str) -> str:
    """A message of pydantic in our words."""
    message = message.removeprefix("Value error, ")
    message = message[:1].lower() + message[1:] if message.startswith("Input") else message
    return message.replace("input should", "must")


def unit_of(key: str) -> str:
    """The unit in a key's name, to follow a sentence."""
    for unit in _UNITS:
        if f"_{key}".endswith(unit):
            return f" (in {unit[1:].replace('_', '/')})"
    return ""


def suggestion(key: str, known: Sequence[str]) -> str:
    """What was perhaps meant by an unknown key, to follow a sentence."""
    stem = re.sub("|".join(f"{unit}$" for unit in _UNITS), "", key)
    other_unit = [name for name in known if name.startswith(stem + "_")]
    close = other_unit or difflib.get_close_matches(key, known, n=1)
    if close:
        return f"; did you mean {close[0]}?"
    return f"; known here: {', '.join(known)}"
