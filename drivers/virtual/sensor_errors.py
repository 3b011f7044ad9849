"""Errors of the inertial sensor before quantisation: bias, noise, scale and cross effects.

Figures of the ADIS16448 data sheet Rev. E, table 1, at 25 degC.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers.adis16448.registers import STANDARD_GRAVITY
from drivers.virtual.inertial_input import Floats

_MILLI_G = STANDARD_GRAVITY / 1000
_KNOT_S = 0.1  # grid of the slow bias drift; its correlation time is 3000 times longer
_REFERENCE_C = 25.0


@dataclass(slots=True, frozen=True)
class SensorGrade:
    """How good a sensor is; standard deviations of what differs from part to part, per axis."""

    accel_noise_density: float = 0.23 * _MILLI_G  # m/s^2/sqrt(Hz)
    accel_turn_on: float = 20 * _MILLI_G  # m/s^2, bias at each start
    accel_drift: float = 0.35 * _MILLI_G  # m/s^2, slow part of the bias
    accel_scale: float = 0.005
    accel_square: float = 0.3 * _MILLI_G / STANDARD_GRAVITY**2  # m/s^2 per (m/s^2)^2
    accel_per_degree: float = 0.15 * _MILLI_G  # m/s^2/degC
    gyro_noise_density: float = math.radians(0.0135)  # rad/s/sqrt(Hz)
    gyro_turn_on: float = math.radians(0.25)  # rad/s
    gyro_drift: float = math.radians(14.5 / 3600)  # rad/s
    gyro_scale: float = 0.005
    gyro_per_accel: float = math.radians(0.015) / STANDARD_GRAVITY  # rad/s per m/s^2
    drift_time_s: float = 300.0  # correlation time of both drifts


# Stands for a JY901: stability as the vendor states it (0.01 g, 0.05 deg/s), noise as small consumer parts have it,
# since no data sheet gives any.
JY901 = SensorGrade(
    accel_noise_density=0.3 * _MILLI_G,
    accel_turn_on=10 * _MILLI_G,
    gyro_noise_density=math.radians(0.01),
    gyro_turn_on=math.radians(0.05),
)


class _Drift:
    """First-order Gauss-Markov process of 6 channels: exact on a grid of knots, straight in between."""

    def __init__(self, rng: np.random.Generator, sigma: Floats, correlation_s: float) -> None:
        self._rng = rng
        self._keep = math.exp(-_KNOT_S / correlation_s)
        self._step = sigma * math.sqrt(1 - self._keep**2)
        self._knots: Floats = (sigma * rng.standard_normal(6))[np.newaxis]
        self._first_knot = 0

    def at(self, t_s: Floats) -> Floats:
        """Values (n, 6) at increasing times (n,) that never go back."""
        position = t_s / _KNOT_S
        left = position.astype(np.int64)
        first, last = int(left[0]), int(left[-1]) + 1
        steps = self._step * self._rng.standard_normal((last - self._first_knot + 1 - len(self._knots), 6))
        value = self._knots[-1]
        grown = [self._knots]
        for step in steps:
            value = self._keep * value + step
            grown.append(value[np.newaxis])
        self._knots = np.concatenate(grown)[first - self._first_knot :]
        self._first_knot = first
        share = (position - left)[:, np.newaxis]
        below = self._knots[left - first]
        return below + share * (self._knots[left - first + 1] - below)


class SensorErrors:
    """One part in one run: its constants are drawn at the start, its noise as it goes.

    The result does not depend on how the samples are cut into chunks.
    """

    def __init__(self, rng: np.random.Generator, grade: SensorGrade | None = None) -> None:
        self.grade = grade = grade or SensorGrade()
        constants, self._noise, drift = rng.spawn(3)
        self.accel_bias = grade.accel_turn_on * constants.standard_normal(3)
        self.gyro_bias = grade.gyro_turn_on * constants.standard_normal(3)
        self._accel_gain = 1 + grade.accel_scale * constants.standard_normal(3)
        self._gyro_gain = 1 + grade.gyro_scale * constants.standard_normal(3)
        self._accel_square = grade.accel_square * constants.standard_normal(3)
        self._accel_per_degree = grade.accel_per_degree * constants.standard_normal(3)
        self._gyro_per_accel = grade.gyro_per_accel * constants.standard_normal(3)
        sigma: Floats = np.repeat([grade.gyro_drift, grade.accel_drift], 3)
        self._drift = _Drift(drift, sigma, grade.drift_time_s)
        self._elapsed_s = 0.0

    def apply(self, dt_s: float, gyro: Floats, accel: Floats, temperature_c: Floats) -> tuple[Floats, Floats]:
        """What the part senses of the next `n` samples, `dt_s` apart.

        Takes gyro (n, 3) [rad/s], accel (n, 3) [m/s^2] and temperature (n,) [degC]; returns gyro and accel,
        continuous (the output registers quantise).
        """
        count = len(gyro)
        times: Floats = self._elapsed_s + dt_s * np.arange(count, dtype=np.float64)
        drift = self._drift.at(times)
        self._elapsed_s += dt_s * count
        # White noise of a density up to half the sample rate: 4.65 mg a sample at 819.2 Hz.
        to_sample = math.sqrt(0.5 / dt_s)
        noise = self._noise.standard_normal((count, 6))
        sensed_gyro = (
            gyro * self._gyro_gain
            + accel * self._gyro_per_accel
            + (self.gyro_bias + drift[:, :3])
            + (self.grade.gyro_noise_density * to_sample) * noise[:, :3]
        )
        warm = (temperature_c - _REFERENCE_C)[:, np.newaxis]
        sensed_accel = (
            accel * (self._accel_gain + self._accel_square * accel)
            + warm * self._accel_per_degree
            + (self.accel_bias + drift[:, 3:])
            + (self.grade.accel_noise_density * to_sample) * noise[:, 3:]
        )
        return sensed_gyro, sensed_accel
