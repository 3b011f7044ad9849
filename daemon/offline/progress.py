"""Parts of one progress bar."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate

Progress = Callable[[float], None]


def shares(progress: Progress | None, *parts: float) -> Sequence[Progress | None]:
    """One progress, 0 to 1, for each of the parts of the work, which follow each other and are 1 together."""
    if progress is None:
        return [None] * len(parts)
    return [_part(progress, end - part, part) for part, end in zip(parts, accumulate(parts), strict=True)]


def _part(progress: Progress, begin: float, length: float) -> Progress:
    return lambda share: progress(begin + share * length)
