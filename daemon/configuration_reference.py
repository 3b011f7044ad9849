"""The reference of all settings, docs/configuration.md, out of the models that check them.

`python -m daemon.configuration_reference > docs/configuration.md` writes it anew.
"""

from __future__ import annotations

import inspect
import json
import re
import sys
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from daemon.settings import Settings

_HEAD = """\
# Configuration

One TOML file. Every key may be left out: then its default holds. An unknown key, a wrong type or a value out of
range is refused at the start, with file, line and key.

```
ramstroke check-config config/ramstroke.toml
```

checks a file and the DBC files that it names. Exit code 0: good; 2: it cannot be used. A relative `dbc` is looked
for beside the configuration file; any other relative path counts from where the program was started.

Examples: `config/ramstroke.toml` (a real support, all keys), `config/trial.toml` (`ramstroke sim` and
`ramstroke run`, two programs on one computer), `config/bench.toml` (a virtual support within `ramstroke run`).

This page is made from the program, see the first lines of `daemon/configuration_reference.py`.
"""

_TABLE_HEAD = ("key", "meaning", "unit", "allowed", "default")
_UNIT = re.compile(r"\s*\[([^\]]+)\]")
_HEXADECIMAL = "arbitration_id"


def generate() -> str:
    """The whole page, Markdown. Raises ValueError naming a key whose model field lacks a description."""
    parts = [_HEAD]
    described: dict[type[BaseModel], str] = {}
    for name, model in sections(Settings):
        if model in described:
            parts.append(f"## [{name}]\n\nNot set. Its keys are those of `[{described[model]}]`.\n")
            continue
        described[model] = name
        parts.append(f"## [{name}]\n\n{_purpose(model)}\n\n{_table(name, model)}\n")
    return "\n".join(parts)


def sections(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Every table of the configuration file, `can.displacement` and its like included, with its model."""
    for key, field in model.model_fields.items():
        inner = nested_model(field.annotation)
        if inner is not None:
            yield f"{prefix}{key}", inner
            yield from sections(inner, f"{prefix}{key}.")


def nested_model(annotation: Any) -> type[BaseModel] | None:
    """The model that a field holds, also one that may be None; None for a plain value."""
    for candidate in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


def _purpose(model: type[BaseModel]) -> str:
    return inspect.cleandoc(model.__doc__ or "")


def _table(section: str, model: type[BaseModel]) -> str:
    properties = model.model_json_schema()["properties"]
    rows = [_TABLE_HEAD, ("---",) * len(_TABLE_HEAD)]
    for key, field in model.model_fields.items():
        if nested_model(field.annotation) is None:
            rows.append(_row(section, key, properties[key]))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _row(section: str, key: str, schema: dict[str, Any]) -> tuple[str, ...]:
    text = schema.get("description", "")
    if not text:
        raise ValueError(f"[{section}] {key} has no description: give its Field one")
    unit = _UNIT.search(text)
    meaning = _UNIT.sub("", text).rstrip(".").replace("|", r"\|")
    return (
        f"`{key}`",
        meaning[:1].upper() + meaning[1:],
        unit.group(1) if unit else "",
        _allowed(key, _plain_type(schema)),
        "not set" if schema["default"] is None else f"`{_literal(key, schema['default'])}`",
    )


def _plain_type(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema without the "or null" of a key that may be left unset."""
    for option in schema.get("anyOf", ()):
        if option.get("type") != "null":
            return dict(option)
    return schema


def _allowed(key: str, schema: dict[str, Any]) -> str:
    if "enum" in schema:
        return ", ".join(f"`{_literal(key, choice)}`" for choice in schema["enum"])
    kind = schema["type"]
    if kind == "boolean":
        return "`true`, `false`"
    if kind == "string":
        return "path" if schema.get("format") == "path" else "text"
    limits = [
        f"{sign} {_literal(key, schema[bound])}"
        for bound, sign in (
            ("minimum", "≥"),
            ("exclusiveMinimum", ">"),
            ("maximum", "≤"),
            ("exclusiveMaximum", "<"),
        )
        if bound in schema
    ]
    return f"{'whole number' if kind == 'integer' else 'number'} {', '.join(limits)}".rstrip()


def _literal(key: str, value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, int) and key == _HEXADECIMAL:
        return f"0x{value:X}"
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return json.dumps(value, ensure_ascii=False)


if __name__ == "__main__":
    sys.stdout.write(generate())
