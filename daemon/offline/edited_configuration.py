"""Values into a configuration file, with where they come from; what else stands in the file stays as it is."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Table

from daemon.configuration import ConfigurationError, load
from daemon.errors import UsageError
from daemon.settings import Settings


def save(path: Path, values: dict[str, dict[str, Any]], settings: Settings, mark: str, origins: dict[str, str]) -> None:
    """Put the values (section -> key -> value) into the file, made from `settings` if there is none.

    `origins` (section -> text that begins with `mark`) stand as comments behind the first key of each section, in place
    of earlier ones. Written beside the file and moved into place once it has been read back as a good configuration.
    Raises UsageError, or ConfigurationError where the file as it stands is none.
    """
    path = path.resolve()  # a link stays one
    if path.exists():
        load(path)  # refuse to write into what is no good configuration
        with path.open(encoding="utf-8", newline="") as file:  # its ends of line stay, too
            document = tomlkit.parse(file.read())
    else:
        document = tomlkit.parse(tomlkit.dumps(json.loads(settings.model_dump_json(exclude_none=True))))
    draft = path.with_name(path.name + ".new")
    try:
        for section, keys in values.items():
            _put(document, section, keys, mark, origins[section])
        with draft.open("w", encoding="utf-8", newline="") as file:
            file.write(tomlkit.dumps(document))
        load(draft)
        if path.exists():
            _take_after(path, draft)
        os.replace(draft, path)
    except (TOMLKitError, ConfigurationError) as error:
        raise UsageError(f"--save {path}: its form is beyond what can be edited here; name a new file") from error
    except OSError as error:
        raise UsageError(f"--save {path}: {error.strerror}; name a file in a folder that can be written") from error
    finally:
        draft.unlink(missing_ok=True)


def _take_after(path: Path, draft: Path) -> None:
    """Mode and owner stay; a user who may not give files away keeps his own."""
    status = path.stat()
    draft.chmod(status.st_mode & 0o7777)
    with suppress(PermissionError):
        os.chown(draft, status.st_uid, status.st_gid)


def _put(document: Any, section: str, keys: dict[str, Any], mark: str, origin: str) -> None:
    """Values that stand there are replaced in place, new ones come first in their section, above what is commented."""
    table = document.get(section, tomlkit.table())
    said = {key: _said(table[key], mark) for key in keys if key in table}
    fresh = tomlkit.table()
    for key, value in keys.items():
        if key not in table:
            fresh.add(key, _number(value))
    body: Iterable[tuple[Any, Any]] = table.value.body if isinstance(table, Table) else table.items()
    for name, item in body:
        if name is None:
            fresh.add(item)  # a comment, an empty line
        else:
            fresh.add(name, item)
    first = next(iter(keys))
    for key, value in keys.items():
        fresh[key] = _number(value)
        comment = "; ".join(part for part in (said.get(key, ""), origin if key == first else "") if part)
        if comment:
            fresh[key].comment(comment)
    document[section] = fresh


def _said(item: Any, mark: str) -> str:
    """A value's own comment, without what an earlier run said."""
    comment: str = item.trivia.comment
    return comment.removeprefix("#").partition(mark)[0].strip().rstrip(";").strip()


def _number(value: Any) -> Any:
    """Six digits: more the data never tell."""
    return float(f"{value:.6g}") if isinstance(value, float) else value
