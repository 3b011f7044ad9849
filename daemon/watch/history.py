"""The last minutes of the stroke as a row of small columns."""

from __future__ import annotations

from collections.abc import Iterable


def spark_rows(
    history: Iterable[tuple[float, float]], full: float, seconds: float, columns: int, rows: int, levels: str
) -> list[str]:
    """`rows` lines, the top one first, of `columns` characters: means of what lies between 0 and `full`.

    The newest value stands at the right; columns without one are blank. Each line adds `len(levels)` heights.
    """
    points = list(history)
    sums, counts = [0.0] * columns, [0] * columns
    if points:
        # Columns stand for fixed spans of time, so that the drawing moves on by whole columns.
        span = seconds / columns
        last = int(points[-1][0] / span)
        for t_s, value in points:
            column = columns - 1 - (last - int(t_s / span))
            if 0 <= column < columns:
                sums[column] += value
                counts[column] += 1
    top = rows * len(levels) - 1
    heights = [
        min(max(round(total / count / full * top), 0), top) if count else None
        for total, count in zip(sums, counts, strict=True)
    ]
    made = []
    for row in reversed(range(rows)):
        base = row * len(levels)
        made.append(
            "".join(
                " " if height is None or height < base else levels[min(height - base, len(levels) - 1)]
                for height in heights
            )
        )
    return made
