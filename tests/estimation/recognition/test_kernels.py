from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from estimation.noise import ACCEL_NOISE
from estimation.recognition.kernels import (
    PRE_LONG_S,
    PRE_SHORT_S,
    SLOW_START,
    SOFT_START,
    SPECS,
    START,
    STOP,
    VIBRATION_LEVELS_M_S2,
    Kernel,
    KernelBank,
    Shape,
    block_means,
)
from estimation.recognition.spectrum import design_lags
from tests.estimation.support import Floats, ramp_response

DT_S = 8 / 819.2
banks = pytest.mark.parametrize("pre_s", [PRE_LONG_S, PRE_SHORT_S])
specs = pytest.mark.parametrize("k", list(Kernel))


@cache
def kernel_bank(dt_s: float, pre_s: float) -> KernelBank:
    """All levels, in the vibration that is assumed before any has been measured."""
    bank = KernelBank(dt_s, pre_s, design_lags(dt_s, round(4.3 / dt_s) + 4))
    for level in range(len(VIBRATION_LEVELS_M_S2)):
        bank.prepare(level)
    return bank


def block_ends(window: int, post: int) -> Floats:
    """Block ends of a window, the step at zero."""
    return np.asarray(np.arange(window) - (window - 1.0 - post)) * DT_S


@pytest.mark.parametrize("shape", [START, SOFT_START, SLOW_START, STOP])
def test_members_are_the_block_means_of_a_second_order_system_behind_a_ramp(shape: Shape) -> None:
    ends = block_ends(140, 123)
    members = shape.members(ends, DT_S)
    assert members.shape == (64, 140)
    fine = 32
    t_s: Floats = DT_S / fine * np.arange(123.0 * fine + 1)
    for member, f, z, ramp in (
        (members[0], shape.frequency_hz[0], shape.damping[0], shape.ramp_s[0]),
        (members[-1], shape.frequency_hz[1], shape.damping[1], shape.ramp_s[1]),
    ):
        means = np.diff(ramp_response(f, z, ramp, t_s)[::fine]) / DT_S
        np.testing.assert_allclose(member[-123:], means, atol=2e-3 * np.abs(means).max())
        assert not member[:-123].any()


@pytest.mark.parametrize("shape", [START, SOFT_START, SLOW_START, STOP])
def test_every_member_ends_at_a_unit_step_of_velocity(shape: Shape) -> None:
    members = shape.members(block_ends(700, 600), DT_S)
    np.testing.assert_allclose(members.sum(axis=1) * DT_S, 1.0, atol=2e-3)


@banks
@specs
def test_kernel_answers_the_mean_burst_of_its_shape_with_its_size(k: Kernel, pre_s: float) -> None:
    bank = kernel_bank(DT_S, pre_s)
    mean = SPECS[k].shape.members(block_ends(bank.window, bank.post_steps[k]), DT_S).mean(axis=0)
    np.testing.assert_allclose(bank.weights[:, k] @ mean, 1.0, rtol=1e-9)


@specs
def test_kernel_answers_each_member_of_its_shape_nearly_so(k: Kernel) -> None:
    bank = kernel_bank(DT_S, PRE_LONG_S)
    members = SPECS[k].shape.members(block_ends(bank.window, bank.post_steps[k]), DT_S)
    answers = members @ bank.weights[0, k]
    # What is seen 0.15 s after the beginning depends on the shape; later hardly.
    assert np.std(answers) < (0.25 if SPECS[k].post_s < 0.2 else 0.09)
    assert np.abs(answers - 1.0).max() < (0.6 if SPECS[k].post_s < 0.2 else 0.3)


@pytest.mark.parametrize(
    ("plain", "sustained"),
    [(Kernel.START_WHOLE, Kernel.START_SUSTAINED), (Kernel.STOP_LATE, Kernel.STOP_SUSTAINED)],
)
@pytest.mark.parametrize("length_s", [0.15, 0.25, 0.35, 0.45])
def test_sustained_kernels_hear_half_of_what_the_others_hear_of_a_pulse(
    plain: Kernel, sustained: Kernel, length_s: float
) -> None:
    bank = kernel_bank(DT_S, PRE_LONG_S)
    largest = []
    for k in (plain, sustained):
        ends = block_ends(bank.window, bank.post_steps[k])
        answers = [
            bank.weights[3, k]
            @ (
                block_means(ends - at_s, DT_S, 8.0, 0.6, 0.08)
                - block_means(ends - at_s - length_s, DT_S, 8.0, 0.6, 0.08)
            )
            for at_s in np.arange(-0.2, 0.3, 0.02)
        ]
        largest.append(max(answers))
    assert largest[1] < 0.66 * max(largest[0], 0.9)


@banks
@specs
def test_kernel_is_blind_to_level_and_nearly_to_drift(k: Kernel, pre_s: float) -> None:
    bank = kernel_bank(DT_S, pre_s)
    level_m_s2, drift_m_s3 = 1.0, 1.5e-3
    answers = bank.weights[:, k].sum(axis=1) * level_m_s2
    assert np.abs(answers).max() < 1e-5  # m/s: nothing beside a step of 14.5 mm/s
    # No more than the stated sigma, of which drift is a part.
    answers = bank.weights[:, k] @ (np.arange(bank.window) * DT_S) * drift_m_s3
    assert (np.abs(answers) < bank.sigma[:, k]).all()


@specs
def test_stated_sigma_in_white_noise_covers_what_noise_does(k: Kernel) -> None:
    bank = kernel_bank(DT_S, PRE_LONG_S)
    rng = np.random.default_rng(k)
    blocks = rng.normal(0.0, ACCEL_NOISE / np.sqrt(DT_S), (4000, bank.window))
    walk = 1.63e-3 * np.sqrt(DT_S) * rng.normal(size=blocks.shape)
    start = bank.window - np.count_nonzero(bank.weights[0, k])
    walk[:, : start + 1] = 0.0  # the level at its window's beginning is free
    drift = 1.5e-3 * rng.normal(size=(4000, 1)) * np.arange(bank.window) * DT_S
    answers = (blocks + np.cumsum(walk, axis=1) + drift) @ bank.weights[0, k]
    # The standard deviation of 4000 values is known to 1.1 %.
    assert np.std(answers) == pytest.approx(bank.sigma[0, k], rel=0.045)


@pytest.mark.parametrize("level", [3, 5, 7])
def test_stated_sigma_in_vibration_covers_band_noise(level: int) -> None:
    bank = kernel_bank(DT_S, PRE_LONG_S)
    # Band noise made at 1024 Hz by cutting a spectrum, then averaged over blocks.
    rng = np.random.default_rng(level)
    rows, fine = 600, 10
    n = bank.window * fine
    spectrum = np.fft.rfft(rng.normal(size=(rows, n)), axis=1)
    f = np.fft.rfftfreq(n, DT_S / fine)
    inside = (f >= 5) & (f <= 60)
    spectrum[:, ~inside] = 0.0
    noise = np.fft.irfft(spectrum, n, axis=1) / np.sqrt(inside.mean())
    assert np.std(noise) == pytest.approx(1.0, rel=0.02)
    blocks = noise.reshape(rows, bank.window, fine).mean(axis=2) * VIBRATION_LEVELS_M_S2[level]
    extra = np.sqrt(bank.sigma[level] ** 2 - 0.9 * bank.sigma[0].min() ** 2)
    answers = np.std(blocks @ bank.weights[level].T, axis=0)
    assert (answers < 1.15 * extra).all()
    assert (answers < bank.sigma[level]).all()


def test_stronger_vibration_never_makes_a_kernel_surer() -> None:
    for pre_s in (PRE_LONG_S, PRE_SHORT_S):
        sigma = kernel_bank(DT_S, pre_s).sigma
        # A sustained kernel trades noise for deafness to pulses, of which its sigma does not speak.
        plain = [k for k, spec in SPECS.items() if not spec.sustained]
        assert (np.diff(sigma[:, plain], axis=0) >= -5e-6).all()
        assert (sigma > 0.0005).all()  # no better than white noise allows: 0.05 s at sqrt(q t)


def test_kernels_fit_a_slow_source_too() -> None:
    bank = kernel_bank(0.8, PRE_LONG_S)
    assert set(bank.post_steps) <= {1, 2}
    assert np.isfinite(bank.weights).all()
    assert np.isfinite(bank.sigma).all()
