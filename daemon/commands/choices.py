"""What options take: names, seeds, folders."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path


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


def seeds(text: str) -> range:
    """`A:B` as the seeds from A to before B; for argparse."""
    first, _, last = text.partition(":")
    try:
        numbers = range(int(first), int(last))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form A:B, such as 1:31") from None
    if not numbers or numbers[0] < 0:
        raise argparse.ArgumentTypeError(f"{text!r} holds no seed: A must be smaller than B and not negative")
    return numbers


def picture_folder(option: str, folder: Path) -> None:
    """Make it, before an hour of computing. Raises UsageError, or PlotError where nothing can be drawn."""
    from daemon.errors import UsageError
    from daemon.offline.evaluation.plots import require_matplotlib

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{option} {folder}: {error.strerror}; name a folder that can be written") from None
    require_matplotlib()
