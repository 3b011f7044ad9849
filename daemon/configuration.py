"""Reading the TOML file: every fault becomes one sentence with file, line and key."""

from __future__ import annotations

import json
import re
import reprlib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from daemon.settings import Settings
from daemon.toml_errors import ConfigurationError as ConfigurationError
from daemon.toml_errors import plain, read_toml, suggestion, unit_of
from drivers.can.dbc import find_signal
from drivers.can.displacement import build_decoders
from drivers.can.settings import CanConfigError


def load(path: Path) -> Settings:
    """Read and check a configuration file, DBC files included. Raises ConfigurationError."""
    text, tree = read_toml(path, "configuration file")
    _anchor_dbc_paths(tree, path.resolve().parent)
    try:
        # As JSON: then "500" is no number and `true` no 1, yet a text may still name a path.
        settings = Settings.model_validate_json(json.dumps(tree, default=str), strict=True)
    except ValidationError as error:
        raise ConfigurationError(_sentences(path, text, error)) from error
    _check_can(settings, path, text)
    return settings


def _check_can(settings: Settings, path: Path, text: str) -> None:
    """Refuse CAN settings that do not fit their DBC files."""
    if not settings.can.enabled:
        return
    location = ["can"]
    try:
        for key, source in (("displacement", settings.can.displacement), ("reference", settings.can.reference)):
            if source is not None:
                location = ["can", key]
                find_signal(source)
        location = ["can"]
        build_decoders(settings.can)
    except CanConfigError as error:
        place = _place(path, text, [*location, *_named_key(str(error))])
        raise ConfigurationError([f"{place}: [{'.'.join(location)}] {error}"]) from error


def _anchor_dbc_paths(tree: dict[str, Any], folder: Path) -> None:
    """A relative DBC path is meant from the configuration file, not from wherever the daemon starts."""
    can = tree.get("can")
    for key in ("displacement", "reference"):
        source = can.get(key) if isinstance(can, dict) else None
        if isinstance(source, dict) and isinstance(source.get("dbc"), str):
            source["dbc"] = str(folder / source["dbc"])


def _sentences(path: Path, text: str, error: ValidationError) -> list[str]:
    sentences = []
    for fault in error.errors():
        location = [str(part) for part in fault["loc"]]
        named = _named_key(plain(fault["msg"])) if fault["type"] == "value_error" else []
        sentences.append(f"{_place(path, text, location + named)}: {_describe(location, fault)}")
    return sentences


def _named_key(message: str) -> list[str]:
    """The key that a fault of several keys names first, below the section it belongs to."""
    named = re.search(r"option `(\w+)`", message) or re.match(r"`?([a-z_]+(?:\.[a-z_]+)*)", message)
    return named.group(1).split(".") if named else []


def _place(path: Path, text: str, location: list[str]) -> str:
    line = _line_of(text, location)
    return f"{path}:{line}" if line else f"{path}"


def _describe(location: list[str], fault: Any) -> str:
    if not location:
        return plain(fault["msg"])
    section, key = ".".join(location[:-1]), location[-1]
    name = f"[{section}] {key}" if section else f"[{key}]"
    if fault["type"] == "extra_forbidden":
        return f"{name} is unknown{_suggestion(location)}"
    if fault["type"] == "value_error":
        return f"[{'.'.join(location)}] {plain(fault['msg'])}"
    value = reprlib.repr(fault["input"])
    if fault["type"] == "model_type":
        return f"{name} = {value}: must be a section with keys of its own"
    return f"{name} = {value}: {plain(fault['msg'])}{unit_of(key)}"


def _suggestion(location: list[str]) -> str:
    model: type[BaseModel] = Settings
    for part in location[:-1]:
        annotation = model.model_fields[part].annotation
        candidates = [annotation, *getattr(annotation, "__args__", ())]
        model = next(c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel))
    return suggestion(location[-1], list(model.model_fields))


def _line_of(text: str, location: list[str]) -> int | None:
    """Line of a key, or of its section if the key is not written there."""
    section: list[str] = []
    found = None
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*\[{1,2}\s*([^\[\]]+?)\s*\]", line)
        if header:
            section = [part.strip().strip("\"'") for part in header.group(1).split(".")]
            if section == location:
                return number
            if section == location[:-1] or section[: len(location)] == location:
                found = found or number
            continue
        key = re.match(r"\s*([\w.\"'-]+)\s*=", line)
        if key:
            full = section + [part.strip("\"'") for part in key.group(1).split(".")]
            if full == location:
                return number
            if full == location[: len(full)]:
                found = number  # an inline table
    return found
