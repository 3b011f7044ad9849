"""What a resting sensor should feel: its noise, its biases, gravity, and which way is up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daemon.doctor.report import Check, fault, not_checked, ok, warning
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.performance import ACCEL_BIAS, CALIBRATED_C, GYRO_BIAS, accel_noise, gyro_noise
from drivers.adis16448.registers import STANDARD_GRAVITY
from estimation.mount.axes import Mount
from estimation.records import ImuSample, Vector
from estimation.settings import AxesSettings

LEAST_SAMPLES = 20
_LOUD, _QUIET = 8.0, 0.2  # times the promised noise; a floor that works shakes a resting support, too
_SIGMAS, _FAR_SIGMAS = 3.0, 8.0  # of a bias
_TILTED_DEG, _WRONG_DEG = 15.0, 45.0
_LET_REST = "let the support and its neighbours rest and run doctor again"
_AXES = ("x", "y", "z")


@dataclass(slots=True, frozen=True)
class Promise:
    """What a sensor's sheet promises, one sigma; no noise: none is stated."""

    gyro_bias: float  # rad/s
    accel_bias: float  # m/s^2
    gyro_noise: float | None = None
    accel_noise: float | None = None
    temperature_c: tuple[float, float] = CALIBRATED_C


JY901 = Promise(math.radians(0.5), 0.010 * STANDARD_GRAVITY)


def adis16448(settings: ImuSettings) -> Promise:
    """Of the ADIS16448 with these filters."""
    return Promise(GYRO_BIAS, ACCEL_BIAS, gyro_noise(settings), accel_noise(settings))


@dataclass(slots=True, frozen=True)
class Felt:
    """Means and standard deviations of good samples, in sensor axes."""

    samples: int
    gyro: Vector  # rad/s
    accel: Vector  # m/s^2
    gyro_sigma: Vector
    accel_sigma: Vector
    temperature_c: float

    @property
    def norm(self) -> float:
        """Of the mean specific force [m/s^2]."""
        return math.hypot(*self.accel)


def felt(samples: Sequence[ImuSample]) -> Felt:
    """Of at least one sample."""
    gyro = np.array([sample.gyro for sample in samples])
    accel = np.array([sample.accel for sample in samples])
    return Felt(
        len(samples),
        _vector(gyro.mean(axis=0)),
        _vector(accel.mean(axis=0)),
        _vector(gyro.std(axis=0)),
        _vector(accel.std(axis=0)),
        float(np.mean([sample.temperature_c for sample in samples])),
    )


def examine(samples: Sequence[ImuSample], promise: Promise, axes: AxesSettings, section: str, who: str) -> list[Check]:
    """All checks of a rest; `section` of the configuration names the axes, `who` goes before each name."""
    names = [f"{who}{name}" for name in ("noise at rest", "gyroscopes at rest", "gravity", "up axis", "temperature")]
    if len(samples) < LEAST_SAMPLES:
        why = f"{len(samples)} good samples came, fewer than {LEAST_SAMPLES}"
        return [not_checked(name, why, "mend what stands above first") for name in names]
    rest = felt(samples)
    noise, gyro, gravity, up, temperature = names
    return [
        judge_noise(noise, rest, promise),
        judge_gyro(gyro, rest, promise),
        judge_gravity(gravity, rest, promise),
        judge_up(up, rest, axes, section),
        judge_temperature(temperature, rest, promise),
    ]


def judge_noise(name: str, rest: Felt, promise: Promise) -> Check:
    """Against the data sheet; a support that shakes looks like a noisy part, and the words say so."""
    figures = {
        "gyro_noise_deg_s": [round(math.degrees(sigma), 4) for sigma in rest.gyro_sigma],
        "accel_noise_mm_s2": [round(1e3 * sigma, 2) for sigma in rest.accel_sigma],
    }
    if not any(rest.gyro_sigma) and not any(rest.accel_sigma):
        return fault(
            name, "all samples are equal: the sensor stands still", "switch the sensor's supply off and on", **figures
        )
    found = (
        f"rates {math.degrees(max(rest.gyro_sigma)):.3f} deg/s, forces {1e3 * max(rest.accel_sigma):.1f} mm/s² "
        "(largest axis, 1σ)"
    )
    if promise.gyro_noise is None or promise.accel_noise is None:
        return ok(name, f"{found}; no sheet states what it should be", **figures)
    ratios = [sigma / promise.gyro_noise for sigma in rest.gyro_sigma]
    ratios += [sigma / promise.accel_noise for sigma in rest.accel_sigma]
    largest = max(ratios)
    figures["times_sheet"] = [round(ratio, 2) for ratio in ratios]
    words = f"{found}, at most {largest:.1f} times the data sheet's {math.degrees(promise.gyro_noise):.3f} deg/s and "
    words += f"{1e3 * promise.accel_noise:.1f} mm/s²"
    if largest > _LOUD:
        advice = f"{_LET_REST}; if the noise stays, fasten the sensor, look at its supply, and then replace it"
        return warning(name, words, advice, **figures)
    if min(ratios) < _QUIET:
        axis = ratios.index(min(ratios))
        what = f"the {_AXES[axis % 3]} {'gyroscope' if axis < 3 else 'accelerometer'}"
        found = f"{found}, but {what} has only {min(ratios):.2f} times the data sheet's noise"
        return warning(name, found, f"{what} may be dead: turn it by hand and see whether its reading moves", **figures)
    return ok(name, words, **figures)


def judge_gyro(name: str, rest: Felt, promise: Promise) -> Check:
    """A bias from start to start is the part's right; more is a motion or a broken part."""
    bias_deg_s = [math.degrees(rate) for rate in rest.gyro]
    limit_deg_s = math.degrees(promise.gyro_bias)
    axis = max(range(3), key=lambda i: abs(bias_deg_s[i]))
    figures = {"gyro_mean_deg_s": [round(rate, 3) for rate in bias_deg_s]}
    found = f"largest mean {bias_deg_s[axis]:+.2f} deg/s on {_AXES[axis]}, turn-on bias {limit_deg_s:g} deg/s (1σ)"
    if abs(bias_deg_s[axis]) <= _SIGMAS * limit_deg_s:
        return ok(name, found, **figures)
    advice = f"{_LET_REST}; if the {_AXES[axis]} gyroscope reads the same then, replace the sensor"
    make = warning if abs(bias_deg_s[axis]) <= _FAR_SIGMAS * limit_deg_s else fault
    return make(name, found, advice, **figures)


def judge_gravity(name: str, rest: Felt, promise: Promise) -> Check:
    """The norm of the specific force, beside standard gravity."""
    off = abs(rest.norm - STANDARD_GRAVITY)
    figures = {"norm_m_s2": round(rest.norm, 4), "accel_mean_m_s2": [round(force, 4) for force in rest.accel]}
    found = f"{rest.norm:.3f} m/s² instead of {STANDARD_GRAVITY:.3f}, bias {promise.accel_bias:.2f} m/s² (1σ)"
    if off <= _SIGMAS * promise.accel_bias:
        return ok(name, found, **figures)
    if off <= _FAR_SIGMAS * promise.accel_bias:
        return warning(
            name, found, f"{_LET_REST}; if it stays, an accelerometer is off: lay the part on each side", **figures
        )
    return fault(name, found, "an accelerometer is broken or its scale is wrong: replace the sensor", **figures)


def judge_up(name: str, rest: Felt, axes: AxesSettings, section: str) -> Check:
    """At rest the specific force points up; which way the push goes no rest can tell."""
    measured = max(range(3), key=lambda i: abs(rest.accel[i]))
    axis = f"{'+' if rest.accel[measured] > 0 else '-'}{_AXES[measured]}"
    off_deg = angle_deg(Mount(axes).to_support(rest.accel), (0.0, 0.0, 1.0))
    figures = {"up": axes.up, "measured_up": axis, "off_deg": round(off_deg, 1)}
    push = f'push = "{axes.push}" cannot be known at rest: `ramstroke review FILE --estimate-mount` finds it'
    found = f'{axis} points up, {off_deg:.1f}° off up = "{axes.up}"; {push}'
    if off_deg <= _TILTED_DEG:
        return ok(name, found, **figures)
    if off_deg <= _WRONG_DEG:
        return warning(
            name,
            found,
            f"turn the sensor to within 10° of its axes, or set pitch_deg and roll_deg in [{section}]",
            **figures,
        )
    return fault(name, found, f'set up = "{axis}" in [{section}], then check push, or turn the sensor', **figures)


def judge_temperature(name: str, rest: Felt, promise: Promise) -> Check:
    """Of the part itself."""
    low, high = promise.temperature_c
    found = f"{rest.temperature_c:.1f} °C inside the part"
    if low <= rest.temperature_c <= high:
        return ok(name, found, temperature_c=round(rest.temperature_c, 1))
    return warning(
        name,
        f"{found}, outside the {low:g} to {high:g} °C in which it is calibrated",
        "shield the sensor from heat or cold; if the figure is absurd, check the data wires",
        temperature_c=round(rest.temperature_c, 1),
    )


def angle_deg(a: Vector, b: Vector) -> float:
    """Between two vectors."""
    cosine = sum(p * q for p, q in zip(a, b, strict=True)) / (math.hypot(*a) * math.hypot(*b) or 1.0)
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


def _vector(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Vector:
    x, y, z = (float(value) for value in values)
    return (x, y, z)
