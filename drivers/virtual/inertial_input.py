"""What the virtual inertial sensor feels: true rates and forces at its internal sampling instants."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.adis16448.registers import BASE_RATE_HZ, STANDARD_GRAVITY

Floats = NDArray[np.float64]
Times = NDArray[np.int64]

_BLOCK = 1024  # samples; small enough that a change of settings recomputes little


@dataclass(slots=True, frozen=True)
class InertialBlock:
    """Successive internal samples of the part, one row each; at least one."""

    t_ns: Times  # (n,) strictly increasing, on the clock of the run
    gyro: Floats  # (n, 3) rad/s
    accel: Floats  # (n, 3) m/s^2, specific force
    temperature_c: Floats  # (n,)


class InertialInput(Protocol):
    """A source of motion."""

    def block(self) -> InertialBlock | None:
        """The samples that follow the last block; None at the end of the input."""


class RecordedInput:
    """A recording, which then also paces the part: one internal sample per row."""

    def __init__(
        self,
        t_ns: ArrayLike,
        gyro: ArrayLike,
        accel: ArrayLike,
        temperature_c: ArrayLike = 25.0,
        *,
        start_ns: int | None = None,
    ) -> None:
        """Take arrays as in InertialBlock; `start_ns` moves the first sample to that instant.

        Raises ValueError if the shapes differ or time does not increase.
        """
        t = np.asarray(t_ns, dtype=np.int64)
        self._t_ns: Times = t if start_ns is None or t.size == 0 else t - t[0] + start_ns
        self._gyro: Floats = np.asarray(gyro, dtype=np.float64)
        self._accel: Floats = np.asarray(accel, dtype=np.float64)
        self._temperature_c: Floats = np.broadcast_to(np.asarray(temperature_c, dtype=np.float64), self._t_ns.shape)
        if self._gyro.shape != (t.size, 3) or self._accel.shape != (t.size, 3):
            raise ValueError(
                f"a recording of {t.size} samples needs gyro and accel of shape ({t.size}, 3), "
                f"not {self._gyro.shape} and {self._accel.shape}"
            )
        if np.any(np.diff(t) <= 0):
            raise ValueError("the times of a recording must increase")
        self._next = 0

    def block(self) -> InertialBlock | None:
        """The next rows of the recording."""
        rows = slice(self._next, self._next + _BLOCK)
        if self._next >= self._t_ns.size:
            return None
        self._next += _BLOCK
        return InertialBlock(self._t_ns[rows], self._gyro[rows], self._accel[rows], self._temperature_c[rows])


class SteadyInput:
    """Rest or steady rotation, for ever or for `duration_s`."""

    def __init__(
        self,
        rate_hz: float = BASE_RATE_HZ,
        *,
        gyro: tuple[float, float, float] = (0.0, 0.0, 0.0),
        accel: tuple[float, float, float] = (0.0, 0.0, STANDARD_GRAVITY),
        temperature_c: float = 25.0,
        start_ns: int = 0,
        duration_s: float | None = None,
    ) -> None:
        self._rate_hz = rate_hz
        self._gyro = gyro
        self._accel = accel
        self._temperature_c = temperature_c
        self._start_ns = start_ns
        self._samples = None if duration_s is None else round(duration_s * rate_hz)
        self._next = 0

    def block(self) -> InertialBlock | None:
        """The next samples."""
        count = _BLOCK if self._samples is None else min(_BLOCK, self._samples - self._next)
        if count <= 0:
            return None
        numbers = np.arange(self._next + 1, self._next + count + 1)
        self._next += count
        return InertialBlock(
            self._start_ns + np.rint(numbers * (1e9 / self._rate_hz)).astype(np.int64),
            np.tile(np.asarray(self._gyro), (count, 1)),
            np.tile(np.asarray(self._accel), (count, 1)),
            np.full(count, self._temperature_c),
        )
