"""The smoother against two independent routes: conditioning of the whole linear system at once, and a textbook RTS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimation.gaussian import Gaussian
from estimation.smoothing.smoother import Smoothed, TapedGaussian

Floats = NDArray[np.float64]
N = 4
ALL = range(N)
Operation = Callable[["Both"], None]


@dataclass
class Both:
    """A state, taped or not, and the same story as one linear system.

    Every number that chance draws (first state, process noise, measurement noise) is an independent component of one
    vector z; each moment's state is states @ z + known, each measurement a row of z with a value.
    """

    state: Gaussian
    variances: list[float]  # of z
    states: Floats  # (N, len(z)), of the present moment
    known: Floats
    rows: list[Floats] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    marked: list[tuple[Floats, Floats]] = field(default_factory=list)

    @property
    def taped(self) -> TapedGaussian:
        assert isinstance(self.state, TapedGaussian)
        return self.state

    @classmethod
    def drawn(cls, seed: int, *, taped: bool = True) -> Both:
        rng = np.random.default_rng(seed)
        mean, root = rng.normal(size=N), rng.normal(size=(N, N))
        gaussian = Gaussian(mean.tolist(), (root @ root.T).tolist())
        return cls(TapedGaussian(gaussian, ALL) if taped else gaussian, [1.0] * N, root, mean)

    def chance(self, i: int, variance: float) -> None:
        """Add a fresh component of z to state i."""
        self.variances.append(variance)
        self.states = np.column_stack([self.states, np.eye(N)[i]])

    def add(self, i: int, j: int, factor: float) -> None:
        self.state.add(i, j, factor)
        self.states[i] += factor * self.states[j]
        self.known[i] += factor * self.known[j]

    def scale(self, i: int, factor: float) -> None:
        self.state.scale(i, factor)
        self.states[i] *= factor
        self.known[i] *= factor

    def push(self, i: int, amount: float) -> None:
        """Known input, written into the mean as the filter does."""
        self.state.x[i] += amount
        self.known[i] += amount

    def diffuse(self, i: int, variance: float) -> None:
        self.state.diffuse(i, variance)
        self.chance(i, variance)

    def reset(self, i: int, mean: float, variance: float) -> None:
        self.state.reset(i, mean, variance)
        self.states[i] = 0.0
        self.known[i] = mean
        self.chance(i, variance)

    def replace(self, i: int, j: int, variance: float) -> None:
        self.state.replace(i, j, variance)
        self.states[i], self.known[i] = self.states[j], self.known[j]
        self.chance(i, variance)

    def measure(self, row: dict[int, float], surprise: float, variance: float) -> None:
        """A reading that lies `surprise` standard deviations beside its prediction."""
        sparse = tuple(row.items())
        innovation = surprise * (self.state.predicted_variance(sparse) + variance) ** 0.5
        value = innovation + sum(a * self.state.x[i] for i, a in sparse)
        self.state.measure(sparse, innovation, variance)
        h = np.array([row.get(i, 0.0) for i in ALL])
        self.variances.append(variance)
        self.states = np.column_stack([self.states, np.zeros(N)])
        self.rows.append(np.append(h @ self.states[:, :-1], 1.0))
        self.values.append(value - h @ self.known)

    def mark(self) -> None:
        self.taped.mark()
        self.marked.append((self.states.copy(), self.known.copy()))

    def conditioned(self) -> list[tuple[Floats, Floats]]:
        """Mean and standard deviation of every marked state, given all measurements: the normal equations of z."""
        size = len(self.variances)

        def padded(rows: Floats) -> Floats:
            return np.pad(np.atleast_2d(rows), ((0, 0), (0, size - np.atleast_2d(rows).shape[1])))

        mean, covariance = np.zeros(size), np.diag(self.variances)
        if self.rows:
            h = np.vstack([padded(row) for row in self.rows])
            gain = np.linalg.solve(h @ covariance @ h.T, h @ covariance).T
            mean, covariance = gain @ np.array(self.values), covariance - gain @ h @ covariance
        told = []
        for states, known in self.marked:
            a = padded(states)
            told.append((a @ mean + known, np.sqrt(np.clip(np.diag(a @ covariance @ a.T), 0.0, None))))
        return told


def assert_are(smoothed: Sequence[Smoothed], expected: Sequence[tuple[Floats, Floats]], tolerance: float) -> None:
    assert len(smoothed) == len(expected)
    for one, (x, sigma) in zip(smoothed, expected, strict=True):
        np.testing.assert_allclose(one.x, x, rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(np.square(one.sigma), sigma**2, rtol=tolerance, atol=tolerance)


indices = st.integers(0, N - 1)
pairs = st.permutations(ALL).map(lambda order: (order[0], order[1]))
factors = st.floats(-1, 1)
variances = st.floats(0.05, 2)
rows = st.dictionaries(indices, st.floats(-2, 2).filter(lambda a: abs(a) > 0.1), min_size=1, max_size=N)
operations = st.one_of(
    st.builds(lambda pair, a: lambda both: both.add(*pair, a), pairs, factors),
    st.builds(lambda i, a: lambda both: both.scale(i, a), indices, factors),
    st.builds(lambda i, a: lambda both: both.push(i, a), indices, factors),
    st.builds(lambda i, q: lambda both: both.diffuse(i, q), indices, variances),
    st.builds(lambda i, a, q: lambda both: both.reset(i, a, q), indices, factors, variances),
    st.builds(lambda i, a: lambda both: both.reset(i, a, 0.0), indices, factors),
    st.builds(lambda pair, q: lambda both: both.replace(*pair, q), pairs, variances),
    st.builds(lambda row, a, r: lambda both: both.measure(row, a, r), rows, st.floats(-3, 3), variances),
)


@given(st.integers(0, 2**32 - 1), st.lists(operations, max_size=25))
@settings(derandomize=True, deadline=None, max_examples=300)
def test_any_story_is_smoothed_as_the_whole_linear_system_conditioned_at_once(
    seed: int, story: list[Operation]
) -> None:
    both = Both.drawn(seed)
    both.mark()
    for operation in story:
        operation(both)
        both.mark()
    assert_are(both.taped.take(), both.conditioned(), 1e-7)


@given(st.lists(operations, min_size=1, max_size=25), st.integers(0, 30))
@settings(derandomize=True, deadline=None)
def test_marks_that_were_kept_are_smoothed_later_as_if_nothing_had_been_taken(
    story: list[Operation], keep: int
) -> None:
    both, whole = Both.drawn(1), Both.drawn(1)
    for operation in story:
        for each in (both, whole):
            operation(each)
            each.mark()
    first = both.taped.take(keep)
    assert len(first) == max(len(story) - keep, 0)
    assert first == whole.taped.take()[: len(first)]
    for each in (both, whole):
        each.measure({0: 1.0, 2: -0.5}, 1.0, 0.3)
        each.mark()
    expected = both.conditioned()[len(first) :]
    assert_are(both.taped.take(), expected, 1e-7)
    assert both.taped.take() == []


@given(st.lists(operations, max_size=25))
@settings(derandomize=True, deadline=None)
def test_the_taped_state_is_the_untaped_one_to_the_last_bit(story: list[Operation]) -> None:
    taped, plain = Both.drawn(2), Both.drawn(2, taped=False)
    for operation in story:
        operation(taped)
        operation(plain)
    assert (taped.state.x, taped.state.p) == (plain.state.x, plain.state.p)


@given(st.lists(operations, min_size=1, max_size=25))
@settings(derandomize=True, deadline=None)
def test_the_last_state_is_the_filtered_one_and_none_is_less_sure_than_the_filter(story: list[Operation]) -> None:
    both = Both.drawn(3)
    filtered = []
    for operation in story:
        operation(both)
        both.mark()
        filtered.append([both.state.sigma(i) for i in ALL])
    smoothed = both.taped.take()
    assert smoothed[-1] == (tuple(both.state.x), tuple(filtered[-1]))
    assert np.all(np.array([one.sigma for one in smoothed]) <= np.array(filtered) + 1e-9)


def test_constant_velocity_agrees_with_rauch_tung_and_striebel() -> None:
    rng = np.random.default_rng(4)
    dt, q, r, steps = 0.1, 0.02, 0.3, 200
    f, noise, h = np.array([[1.0, dt], [0.0, 1.0]]), np.diag([0.0, q * dt]), np.array([1.0, 0.0])
    readings = np.cumsum(np.full(steps, 1.5 * dt)) + rng.normal(0.0, r**0.5, steps)

    x, p = np.array([0.0, 0.0]), np.diag([4.0, 1.0])
    taped = TapedGaussian(Gaussian(x.tolist(), p.tolist()), (0, 1))
    filtered, predicted = [], []
    for z in readings:
        x, p = f @ x, f @ p @ f.T + noise
        predicted.append((x, p))
        gain = p @ h / (h @ p @ h + r)
        x, p = x + gain * (z - h @ x), (np.eye(2) - np.outer(gain, h)) @ p
        filtered.append((x, p))
        taped.add(0, 1, dt)
        taped.diffuse(1, q * dt)
        taped.measure(((0, 1.0),), z - taped.x[0], r)
        taped.mark()

    told = [(x, np.sqrt(np.diag(p)))]
    for k in range(steps - 2, -1, -1):
        (mean, covariance), (ahead, ahead_p) = filtered[k], predicted[k + 1]
        gain = covariance @ f.T @ np.linalg.inv(ahead_p)
        x, p = mean + gain @ (x - ahead), covariance + gain @ (p - ahead_p) @ gain.T
        told.insert(0, (x, np.sqrt(np.diag(p))))
    smoothed = taped.take()
    assert_are(smoothed, told, 1e-9)
    # What came after does help, most of all in the middle.
    assert smoothed[steps // 2].sigma[1] < 0.8 * np.sqrt(filtered[steps // 2][1][1, 1])


def test_a_state_that_is_forgotten_tells_nothing_of_what_it_was() -> None:
    taped = TapedGaussian(Gaussian.diagonal([1.0, 2.0], [3.0, 4.0]), (0, 1))
    taped.mark()
    taped.reset(0, 5.0, 9.0)
    taped.measure(((0, 1.0), (1, 1.0)), 0.7, 0.1)
    taped.measure(((0, 1.0),), -0.7, 0.1)
    [before] = taped.take()
    assert (before.x[0], before.sigma[0]) == (1.0, 3.0)
    assert before.sigma[1] < 0.2 * 4.0


def test_an_exact_measurement_is_exact_before_it_too_and_one_of_what_is_exact_says_nothing() -> None:
    taped = TapedGaussian(Gaussian.diagonal([1.0, 0.0], [3.0, 0.0]), (0, 1))
    taped.mark()
    taped.add(1, 0, 2.0)
    taped.measure(((1, 1.0),), 6.0, 0.0)
    taped.measure(((1, 1.0),), 1.0, 0.0)
    [before] = taped.take()
    assert before.x == pytest.approx((4.0, 0.0))
    assert before.sigma == pytest.approx((0.0, 0.0), abs=1e-7)


def test_copies_go_on_without_a_tape() -> None:
    taped = TapedGaussian(Gaussian.diagonal([1.0], [3.0]), (0,))
    taped.mark()
    taped.copy().measure(((0, 1.0),), 1.0, 0.1)
    assert taped.take() == [((1.0,), (3.0,))]
