"""A small Gaussian state in plain floats, moved by elementary row operations.

Every model of the filter is a handful of shears, scalings and scalar measurements; written this way each costs
a few additions instead of a full matrix product, and any state layout works.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

Row = Sequence[tuple[int, float]]  # sparse row: (state index, coefficient)


@dataclass(slots=True)
class Gaussian:
    """Mean x (n,) and covariance p (n, n), symmetric; units are the caller's."""

    x: list[float]
    p: list[list[float]]

    def __post_init__(self) -> None:
        n = len(self.x)
        if len(self.p) != n or any(len(row) != n for row in self.p):
            raise ValueError("mean and covariance differ in size")

    @classmethod
    def diagonal(cls, mean: Sequence[float], sigma: Sequence[float]) -> Gaussian:
        """Independent states with the given means and standard deviations."""
        n = len(mean)
        return cls(list(mean), [[sigma[i] ** 2 if i == j else 0.0 for j in range(n)] for i in range(n)])

    def copy(self) -> Gaussian:
        """Independent copy."""
        return Gaussian(self.x.copy(), [row.copy() for row in self.p])

    def sigma(self, i: int) -> float:
        """Standard deviation of state i."""
        return sqrt(max(self.p[i][i], 0.0))

    def add(self, i: int, j: int, factor: float) -> None:
        """x_i += factor * x_j (i != j), with the covariance that follows."""
        p = self.p
        self.x[i] += factor * self.x[j]
        p[i] = [a + factor * b for a, b in zip(p[i], p[j], strict=True)]
        for row in p:
            row[i] += factor * row[j]

    def scale(self, i: int, factor: float) -> None:
        """x_i *= factor."""
        self.x[i] *= factor
        self.p[i] = [factor * a for a in self.p[i]]
        for row in self.p:
            row[i] *= factor

    def diffuse(self, i: int, variance: float) -> None:
        """Add process noise to state i."""
        self.p[i][i] += variance

    def reset(self, i: int, mean: float, variance: float) -> None:
        """Forget all about state i and start it anew, independent of the others."""
        self.x[i] = mean
        self.p[i] = [0.0] * len(self.x)
        for row in self.p:
            row[i] = 0.0
        self.p[i][i] = variance

    def replace(self, i: int, j: int, variance: float) -> None:
        """x_i := x_j + noise of the given variance (i != j)."""
        self.reset(i, 0.0, 0.0)
        self.add(i, j, 1.0)
        self.diffuse(i, variance)

    def block(self, states: Sequence[int]) -> Gaussian:
        """The marginal of some states."""
        return Gaussian([self.x[i] for i in states], [[self.p[i][j] for j in states] for i in states])

    def set_block(self, states: Sequence[int], block: Gaussian) -> None:
        """Replace some states by a Gaussian of their own, independent of the others."""
        for i in states:
            self.reset(i, 0.0, 0.0)
        for a, i in enumerate(states):
            self.x[i] = block.x[a]
            for b, j in enumerate(states):
                self.p[i][j] = block.p[a][b]

    def predicted_variance(self, row: Row) -> float:
        """Variance of the linear combination `row`."""
        p = self.p
        return sum(a * b * p[i][j] for i, a in row for j, b in row)

    def covariance_with(self, row: Row) -> list[float]:
        """Covariance (n,) of the state with the linear combination `row`."""
        return [sum(line[j] * b for j, b in row) for line in self.p]

    def measure(self, row: Row, innovation: float, variance: float, hold: Sequence[int] = ()) -> float:
        """Scalar measurement of `row` with the given innovation; returns the innovation's variance.

        The covariance is updated as P - K S K^T with K = P h / S, symmetric by construction. States in `hold` are
        considered but not changed (Schmidt): what the measurement tells of them has been used already.
        """
        p = self.p
        ph = self.covariance_with(row)
        s = variance + sum(ph[i] * a for i, a in row)
        if s <= 0.0:
            return s  # both the state and the measurement claim to be exact: nothing to learn
        gain = [value / s for value in ph]
        if hold:
            # P - k (P h)^T - (P h) k^T + s k k^T, of which nothing is left where both gains are held.
            held = [gain[i] if i in hold else 0.0 for i in range(len(gain))]
            for i in hold:
                gain[i] = 0.0
            self.x = [a + k * innovation for a, k in zip(self.x, gain, strict=True)]
            for k, h, line in zip(gain, held, p, strict=True):
                for j, value in enumerate(ph):
                    # s k_i k_j for two free states, s k_i h_j where one of them is held
                    line[j] -= k * value + h * s * gain[j]
            return s
        self.x = [a + k * innovation for a, k in zip(self.x, gain, strict=True)]
        for k, line in zip(gain, p, strict=True):
            if k:
                for j, value in enumerate(ph):
                    line[j] -= k * value
        return s
