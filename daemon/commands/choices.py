"""Names that an option takes."""

from __future__ import annotations

from collections.abc import Iterable


def known(option: str, name: str, names: Iterable[str]) -> str:
    """The name, if it is one of them. Raises UsageError with the nearest, or with how to see them all."""
    from difflib import get_close_matches

    from daemon.errors import UsageError

    names = tuple(names)
    if name in names:
        return name
    near = get_close_matches(name, names, n=1)
    hint = f"did you mean {near[0]}?" if near else f"{option} list shows what there is"
    raise UsageError(f"{option} {name} is unknown; {hint}")
