"""A function compiled by numba, where that is installed and there is enough to do; the numbers are the same.

Compiling takes a second or two: worth it for a swarm of thousands of evaluations, not for the thirty of a line search.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from typing import Any

ENOUGH = 1500  # evaluations asked for in this process

_asked = 0


def wanted(evaluations: int) -> bool:
    """Whether so many more are worth compiling for."""
    global _asked  # how much has been asked for is a fact of the process, not of a caller
    _asked += evaluations
    return _asked > ENOUGH and _is_installed()


@cache
def of(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, compiled. Order of operations is kept: no fast mathematics."""
    import numba

    made: Callable[..., Any] = numba.njit(function, error_model="numpy")
    return made


@cache
def _is_installed() -> bool:
    return find_spec("numba") is not None
