"""Arrays that survive as lists in a snapshot."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainSerializer, PlainValidator

FloatArray = NDArray[np.float64]

# Lists in a snapshot, arrays in the program.
Array = Annotated[
    FloatArray,
    PlainValidator(lambda values: np.array(values, dtype=np.float64)),
    PlainSerializer(lambda a: a.tolist(), return_type=list),
]


class RollingWindow:
    """The last `n` values, or rows, in one piece of memory: adding one moves nothing but every n-th time."""

    def __init__(self, last: FloatArray) -> None:
        self._size = len(last)
        self._memory = np.concatenate([last, np.zeros_like(last)])
        self._end = self._size

    @property
    def values(self) -> FloatArray:
        """A view of them, newest last, until the next is added."""
        return self._memory[self._end - self._size : self._end]

    def add(self, value: float | FloatArray) -> None:
        """Take the next one; the oldest is forgotten."""
        if self._end == len(self._memory):
            self._memory[: self._size] = self.values
            self._end = self._size
        self._memory[self._end] = value
        self._end += 1

    def fill(self, value: float) -> None:
        """Let all of them be one value."""
        self._memory[:] = value


Rolling = Annotated[
    RollingWindow,
    PlainValidator(lambda values: RollingWindow(np.array(values, dtype=np.float64))),
    PlainSerializer(lambda window: window.values.tolist(), return_type=list),
]
