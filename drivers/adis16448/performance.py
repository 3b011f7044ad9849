"""What the data sheet (Rev. E, table 1) promises of a part at rest."""

from __future__ import annotations

import math

import numpy as np

from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.registers import ACCEL_LSB, GYRO_LSB_DPS, STANDARD_GRAVITY

CLOCK_ERROR = 0.03  # of the sample rate, as a share
GYRO_BIAS = math.radians(0.5)  # rad/s, one sigma from start to start
ACCEL_BIAS = 0.020 * STANDARD_GRAVITY  # m/s^2, the same
CALIBRATED_C = (-40.0, 85.0)

_GYRO_NOISE = math.radians(0.27)  # rad/s, rms of the unfiltered output
_ACCEL_NOISE = 0.0051 * STANDARD_GRAVITY  # m/s^2


def noise_gain(settings: ImuSettings) -> float:
    """What share of white noise passes the digital filters."""
    taps = np.full(1 << settings.filter_taps_exponent, 0.5**settings.filter_taps_exponent)
    block = np.full(1 << settings.decimation_exponent, 0.5**settings.decimation_exponent)
    response = np.convolve(np.convolve(taps, taps), block)
    return float(np.sqrt(np.sum(response**2)))


def gyro_noise(settings: ImuSettings) -> float:
    """Noise of a sample [rad/s], one sigma, steps of the output included."""
    step = math.radians(GYRO_LSB_DPS[settings.gyro_range_dps])
    return math.hypot(_GYRO_NOISE * noise_gain(settings), step / math.sqrt(12))


def accel_noise(settings: ImuSettings) -> float:
    """Noise of a sample [m/s^2], one sigma, steps of the output included."""
    return math.hypot(_ACCEL_NOISE * noise_gain(settings), ACCEL_LSB / math.sqrt(12))
