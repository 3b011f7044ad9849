"""The reference of fault scripts, docs/faults.md, out of the models that check them.

`python -m daemon.simulation.fault_reference > docs/faults.md` writes it anew.
"""

from __future__ import annotations

import json
import sys
from typing import Any

from drivers.virtual.faults import (
    BusFault,
    EdgeFault,
    Fault,
    FrameFault,
    InterfaceFault,
    Jy901Fault,
    PartFault,
    SerialFault,
    ValueFault,
    WireFault,
)

_HEAD = """\
# Fault scripts

What goes wrong with the virtual devices, when, and for how long: one TOML file, played by the virtual support.

```
ramstroke demo --faults config/faults/wet_cable.toml
ramstroke sim --config config/trial.toml --faults config/faults/long.toml
```

```toml
seed = 1          # of everything random in the script (default 1)

[[fault]]
kind = "miso_low" # the data wire of the sensor is shorted to ground
at_s = 12.0       # 12 s after the start of the simulation
for_s = 3.0       # for 3 s

[[fault]]
kind = "jump"     # and meanwhile the displacement is off
at_s = 13.0
for_s = 5.0
offset_mm = 40.0
```

Every table `[[fault]]` is one fault. `kind`, `at_s` (≥ 0) and `for_s` (> 0) must be there. Faults may stand in any
order and overlap; those that change the same thing act one after the other, in the order of the file. Before and after
a fault the devices behave as if there were none: the script has random generators of its own, so the motion, the noise
and every value outside the faults are those of the same seed without a script. (A part that lost its supply has lost
its registers, too, and what is delayed holds up what follows.)

A file that cannot be used is refused at the start with file, line and key; exit code 2.

`ramstroke demo --faults` ends with what the script did and what the estimator said, in order of time; moves that were
missed are no failure then. `ramstroke sim --json` prints at its end what it did, so that every sample can be accounted
for:

| field | content |
| --- | --- |
| `duration_s` | how long it ran |
| `part.updates` | samples that the part made, one data-ready edge each |
| `part.edges` | edges that arrived at the listener's end of the wire |
| `part.edges_lost_by_script`, `part.edges_added_by_script` | lost and doubled on the wire |
| `jy901.groups` | samples that a JY901 sent; `part`, `socket` and `jy901` are null where the part is not used |
| `jy901.bytes`, `jy901.unread` | bytes that came to the computer's port, and those that nobody read in time |
| `jy901.lost_by_script`, `jy901.flipped_by_script`, `jy901.added_by_script` | bytes on its line |
| `socket.frames`, `socket.failed_frames` | SPI frames asked for, and those that ended in an error by script |
| `socket.edges` | edges told to listeners, those that came too fast for a busy one included |
| `can.sent`, `can.failed`, `can.sent_by_kind` | CAN frames; the kinds are the identifiers and `error frame` |
| `faults` | the faults that began while it ran |

Files that come with the program: `config/faults/wet_cable.toml` (a minute, for `demo`) and `config/faults/long.toml`
(30 minutes, every kind of the ADIS16448 and of the bus that needs no virtual interface, for `sim`);
`config/faults/serial.toml` (two minutes, every kind of a JY901, for `sim` and `demo --imu jy901`).

This page is made from the program, see the first lines of `daemon/simulation/fault_reference.py`.
"""

_SECTIONS = (
    ("The inertial sensor itself", PartFault),
    ("Its data wire, and the computer's SPI port", WireFault),
    ("Its data-ready wire", EdgeFault),
    ("A JY901 (only with `use` in `[jy901]`)", Jy901Fault),
    ("Its serial line, and the computer's port", SerialFault),
    ("The displacement sensor", ValueFault),
    ("The controller's frames", FrameFault),
    ("The CAN bus", BusFault),
    ('The CAN interface (only with `can.interface = "virtual"`)', InterfaceFault),
)
_COMMON = ("at_s", "for_s", "kind")
_HEXADECIMAL = ("arbitration_id", "lot_id")


def generate() -> str:
    """The whole page, Markdown."""
    parts = [_HEAD]
    for title, union in _SECTIONS:
        rows = [_row(kind) for kind in union.__args__]
        parts.append(
            f"## {title}\n\n| kind | what it imitates | keys (default) |\n| --- | --- | --- |\n" + "".join(rows)
        )
    return "\n".join(parts)


def _row(model: type[Fault]) -> str:
    schema = model.model_json_schema()
    required = schema["required"]
    keys = [
        f"`{key}` ({'must be there' if key in required else _default(key, field)}): {_meaning(key, field)}"
        for key, field in schema["properties"].items()
        if key not in _COMMON
    ]
    return f"| `{schema['properties']['kind']['const']}` | {model.__doc__} | {'; '.join(keys)} |\n"


def _default(key: str, field: dict[str, Any]) -> str:
    return "not set" if field["default"] is None else _literal(key, field["default"])


def _meaning(key: str, field: dict[str, Any]) -> str:
    number = next((option for option in field.get("anyOf", ()) if option["type"] != "null"), field)
    choices = field.get("enum") or field.get("items", {}).get("enum")
    if choices:
        return f"{field['description']}: {', '.join(choices)}"
    signs = (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
    limits = [f"{sign} {_literal(key, number[bound])}" for bound, sign in signs if bound in number]
    return f"{field['description']}, {', '.join(limits)}"


def _literal(key: str, value: Any) -> str:
    if isinstance(value, int) and key in _HEXADECIMAL:
        return f"0x{value:X}"
    return f"{value:g}" if isinstance(value, float) else json.dumps(value)


if __name__ == "__main__":
    sys.stdout.write(generate())
