"""Numbers as the view writes them."""

from __future__ import annotations

from math import isnan


def figure(value: float, form: str) -> str:
    """The number, or a dash as wide if it is not known; `form` as in format strings."""
    return "–".rjust(len(f"{0.0:{form}}")) if isnan(value) else f"{value:{form}}"
