"""Reading a fault script: every fault of the file becomes one sentence with file, line and key."""

from __future__ import annotations

import json
import re
import reprlib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from daemon.errors import UsageError
from daemon.toml_errors import ConfigurationError, plain, read_toml, suggestion, unit_of
from drivers.virtual.faults import KINDS, EdgeFault, FaultScript, Jy901Fault, PartFault, SerialFault, WireFault


def load_faults(path: Path) -> FaultScript:
    """Read and check a fault script. Raises ConfigurationError."""
    text, tree = read_toml(path, "fault script")
    try:
        # As JSON: then "5" is no number and `true` no 1.
        return FaultScript.model_validate_json(json.dumps(tree, default=str), strict=True)
    except ValidationError as error:
        faults = [fault for fault in error.errors() if not _is_echo(fault)]
        raise ConfigurationError([_sentence(path, text, fault) for fault in faults]) from error


def refuse_unplayable(script: FaultScript, use: str) -> None:
    """Raise UsageError if a fault of the script is one of a part that `jy901.use` leaves out."""
    for fault in script.fault:
        if use == "no" and isinstance(fault, SerialFault | Jy901Fault):
            raise UsageError(
                f"the fault script has {fault.kind}, which only a JY901 can play: set use in [jy901], or --imu of demo"
            )
        if use == "instead" and isinstance(fault, PartFault | WireFault | EdgeFault):
            raise UsageError(
                f"the fault script has {fault.kind}, which only an ADIS16448 can play, and a JY901 is in its place: "
                "delete it from the script"
            )


def _is_echo(fault: Any) -> bool:
    """A list whose only item is refused is also called empty."""
    return fault["type"] == "too_short" and bool(fault["input"])


def _sentence(path: Path, text: str, fault: Any) -> str:
    """The location is ("fault", number from 0, kind, key, ...), or a key beside the tables."""
    location = [part for part in fault["loc"] if part != "__root__"]
    number = location[1] if len(location) > 1 and location[0] == "fault" else None
    kind = location[2] if len(location) > 2 else None
    key = location[3] if len(location) > 3 else location[-1] if number is None and location else "kind"
    line = _line_of(text, number, str(key))
    where = "" if number is None else f"fault {number + 1}: " if kind is None else f"fault {number + 1} ({kind}): "
    return f"{path}{f':{line}' if line else ''}: {where}{_describe(fault, kind, str(key))}"


def _describe(fault: Any, kind: str | None, key: str) -> str:
    value = fault["input"]
    if fault["type"] == "union_tag_not_found":
        return f"kind is missing; known are {', '.join(KINDS)}"
    if fault["type"] == "union_tag_invalid":
        return f"kind = {reprlib.repr(value['kind'])} is unknown{suggestion(str(value['kind']), list(KINDS))}"
    if fault["type"] == "extra_forbidden":
        model = KINDS[kind] if kind else FaultScript
        return f"{key} is unknown{suggestion(key, list(model.model_fields))}"
    if fault["type"] == "missing":
        return f"{key} is missing{unit_of(key)}"
    if fault["type"] in ("dict_type", "model_type", "tuple_type") and kind is None:
        return "every fault is a table that begins with [[fault]]"
    if fault["type"] == "too_short":
        return f"{key} names nothing"
    return f"{key} = {reprlib.repr(value)}: {plain(fault['msg'])}{unit_of(key)}"


def _line_of(text: str, number: int | None, key: str) -> int | None:
    """Line of a key within fault `number`, or of its [[fault]]; without a number, of a key beside the tables."""
    found, tables = None, -1
    for line_number, line in enumerate(text.splitlines(), start=1):
        if re.match(r"\s*\[\[\s*fault\s*\]\]", line):
            tables += 1
            if tables == number:
                found = line_number
        named = re.match(r"\s*[\"']?([\w-]+)[\"']?\s*=|\s*\[+\s*([\w-]+)", line)
        if named and key in named.groups() and tables == (-1 if number is None else number):
            return line_number
    return found
