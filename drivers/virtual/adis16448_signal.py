"""The virtual ADIS16448 between its sensors and its output registers: filters, decimation, quantisation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.adis16448.crc import CRC_TABLE
from drivers.adis16448.registers import (
    ACCEL_LSB,
    GYRO_LSB_DPS,
    MAGN_LSB,
    TEMP_AT_ZERO_C,
    TEMP_LSB,
)
from drivers.virtual.inertial_input import Floats

CHANNELS = 7  # gyro xyz [rad/s], accel xyz [m/s^2], temperature [degC]
HISTORY = 254  # samples before the present one that the longest filter still holds
FRAME_BYTES = 22  # XGYRO_OUT..TEMP_OUT

# A place in the northern mid-latitudes at 1000 mbar, z up.
_FIELD_T = (20e-6, 0.0, -45e-6)
_PRESSURE_WORD = 0xC350

_GYRO_LIMIT = 30_000  # counts: 1.2 times the range
_ACCEL_LIMIT = 21_600  # counts: 18 g

_Words = NDArray[np.uint16]
_CRC: _Words = np.array(CRC_TABLE, dtype=np.uint16)


class FilterPath:
    """Two averages of 2^B samples in cascade (a Bartlett window), then the mean of every 2^D results."""

    def __init__(self, taps_exponent: int, decimation_exponent: int, history: Floats) -> None:
        """Start with `history` (HISTORY, CHANNELS), the samples before the first one to come."""
        box = np.full(1 << taps_exponent, 0.5**taps_exponent)
        self._window: Floats = np.convolve(box, box)
        reach = len(self._window) - 1
        self._tail = history[len(history) - reach :]
        self._size = 1 << decimation_exponent
        self._group: Floats = np.empty((0, CHANNELS))

    def feed(self, samples: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Filter samples (n, CHANNELS); return the outputs and the row of the sample that completes each."""
        reach = len(self._tail)
        filtered = samples
        if reach and len(samples):
            joined = np.concatenate([self._tail, samples])
            self._tail = joined[-reach:]
            filtered = samples.copy()  # the temperature is not filtered
            for column in range(6):
                filtered[:, column] = np.convolve(joined[:, column], self._window, "valid")
        if self._size == 1:
            return np.arange(len(samples)), filtered
        waiting = len(self._group)
        rows = np.concatenate([self._group, filtered])
        outputs = len(rows) // self._size
        self._group = rows[outputs * self._size :]
        means = rows[: outputs * self._size].reshape(outputs, self._size, CHANNELS).mean(axis=1)
        return (np.arange(outputs) + 1) * self._size - waiting - 1, means


@dataclass(slots=True, frozen=True)
class OutputRows:
    """What the output registers hold, update by update."""

    frames: bytes  # FRAME_BYTES each, as a burst sends them
    checksums: bytes  # 2 each
    overrange: list[bool]


def quantise(values: Floats, gyro_range_dps: int, decimation_exponent: int, offsets: Floats) -> OutputRows:
    """Output registers for filtered `values` (n, CHANNELS), with `offsets` (6,) added just before."""
    count = len(values)
    gyro_lsb = math.radians(GYRO_LSB_DPS[gyro_range_dps])
    counts = np.empty((count, 11), dtype=np.int64)
    gyro = np.rint((values[:, :3] + offsets[:3]) / gyro_lsb)
    accel = np.rint((values[:, 3:6] + offsets[3:]) / ACCEL_LSB)
    rounded = np.concatenate([gyro, accel], axis=1)
    limits = np.repeat([_GYRO_LIMIT, _ACCEL_LIMIT], 3)
    counts[:, 0:6] = np.clip(rounded, -limits, limits)
    # The four lowest bits of the field rest at the full rate; decimation wakes one each.
    resting = (1 << max(0, 4 - decimation_exponent)) - 1
    counts[:, 6:9] = np.rint(np.array(_FIELD_T) / MAGN_LSB).astype(np.int64) & ~resting
    counts[:, 9] = _PRESSURE_WORD
    counts[:, 10] = np.clip(np.rint((values[:, 6] - TEMP_AT_ZERO_C) / TEMP_LSB), -2048, 2047)
    overrange = (np.abs(rounded) > limits).any(axis=1).tolist()
    words: _Words = (counts & 0xFFFF).astype(np.uint16)
    return OutputRows(words.astype(">u2").tobytes(), _checksums(words).astype(">u2").tobytes(), overrange)


def _checksums(words: _Words) -> _Words:
    register = np.full(len(words), 0xFFFF, dtype=np.uint16)
    for column in words.T:
        register ^= column
        for _ in range(2):
            register = (register >> 8) ^ _CRC[register & 0xFF]
    return ~register.byteswap()
