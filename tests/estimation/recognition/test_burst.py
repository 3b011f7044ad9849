"""The fit of a whole burst, against bursts integrated by another route and against the information in them."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.noise import hidden_covariance
from estimation.recognition.burst import START, STOP, BurstPrior, BurstView, fit_burst
from estimation.recognition.spectrum import design_lags
from tests.estimation.support import Floats, ramp_response

DT_S = 8 / 819.2
N, POST = 340, 84  # blocks; of these after the guess
SPEED = 0.01453
DRAWS = 80


def burst_means(shape: Floats) -> Floats:
    """Block means (N,) of a unit step of that ln f, ln damping, ln ramp and t0, integrated numerically."""
    fine = 32
    frequency, damping, ramp_s = np.exp(shape[:3])
    edges = DT_S * (np.arange(N + 1.0) - (N - POST)) - shape[3]  # relative to the beginning
    t_s = DT_S / fine * np.arange((POST + 12) * fine + 1.0)
    velocity = np.interp(edges, t_s, ramp_response(frequency, damping, ramp_s, t_s), left=0.0)
    return np.asarray(np.diff(velocity) / DT_S)


def view_of(levelled: Floats) -> BurstView:
    times = np.rint(1e9 * DT_S * (np.arange(1.0, N + 1.0) - (N - POST))).astype(np.int64)
    return BurstView(DT_S, times, levelled, np.zeros(N), design_lags(DT_S, N))


def bound(shape: Floats, prior: BurstPrior) -> float:
    """Least sigma of the step [m/s] that any unbiased estimator can reach: Fisher information and the priors."""
    noise = hidden_covariance(N, DT_S) + 0.003**2 * np.eye(N) * 0.7
    nudge = np.diag([0.01, 0.02, 0.02, 0.0005])
    slopes = [burst_means(shape)]
    for step in nudge:
        slopes.append(SPEED * (burst_means(shape + step) - burst_means(shape - step)) / (2 * step.sum()))
    jacobian = np.column_stack(slopes)
    information = jacobian.T @ np.linalg.solve(noise, jacobian) + np.diag(np.append(0.0, prior.sigma**-2.0))
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))


@pytest.mark.parametrize(("prior", "stop"), [(START, False), (STOP, True)])
def test_a_fit_reaches_the_information_bound_and_says_so(prior: BurstPrior, stop: bool) -> None:
    rng = np.random.default_rng(8)
    root = np.linalg.cholesky(hidden_covariance(N, DT_S))
    sign = -1.0 if stop else 1.0
    errors, stated, times, bounds = [], [], [], []
    for _ in range(DRAWS):
        shape = prior.mean + prior.sigma * np.array([0.8, 0.8, 0.8, 0.4]) * rng.normal(size=4)
        felt = sign * SPEED * burst_means(shape) + root @ rng.normal(size=N)
        found = fit_burst(view_of(felt - felt[-1]), prior, 0, stop=stop)
        assert found is not None
        errors.append(found.step_m_s - sign * SPEED)
        stated.append(found.sigma_m_s)
        times.append(found.t_ns * 1e-9 - shape[3])
        bounds.append(bound(shape, prior))
    # The rms of 80 normal values is known to 8 %: two such apart are a fault.
    rms, honest = np.sqrt(np.mean(np.square(errors))), np.sqrt(np.mean(np.square(stated)))
    assert rms < 1.2 * np.sqrt(np.mean(np.square(bounds)))
    assert honest == pytest.approx(np.sqrt(np.mean(np.square(bounds))), rel=0.15)
    assert np.median(np.abs(times)) < 0.004  # s
    assert np.abs(np.array(errors) / stated).max() < 4.0


def test_two_bursts_and_the_usual_speed_bound_the_end_of_an_inertial_push() -> None:
    """First cycle on a quiet bench: 2.5 % of speed beforehand, two bursts, 34.4 s (reference: 5.6 | 16 mm)."""
    start, stop = bound(START.mean, START), bound(STOP.mean, STOP)
    sigma = (1 / (0.025 * SPEED) ** 2 + 1 / start**2 + 1 / stop**2) ** -0.5
    end_mm = sigma * 34.4 * 1e3
    # White noise alone over half a second leaves about 0.5 mm/s a burst, so 7 to 10 mm at the end of 500 mm.
    assert 0.3e-3 < start < 0.7e-3
    assert 0.3e-3 < stop < 0.7e-3
    assert 6.5 < end_mm < 10.5


def test_too_little_around_a_burst_is_no_burst() -> None:
    view = view_of(np.zeros(N))
    assert fit_burst(view, START, int(view.times_ns[-1]), stop=False) is None
    assert fit_burst(view, START, int(view.times_ns[0]), stop=False) is None
