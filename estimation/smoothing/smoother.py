"""Fixed-interval smoother on the elementary operations of a Gaussian state: modified Bryson-Frazier.

A filter knows of each moment only what came before it. Here its operations are kept on a tape; backwards along it an
adjoint pair, lambda (n,) and Lambda (n, n), gathers what came after, and x - P lambda with covariance P - P Lambda P
is the estimate from all data (G. J. Bierman, Fixed interval smoothing with discrete measurements, International
Journal of Control 18(1), 1973). P is never inverted, so states that are forgotten or known exactly need no care.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from math import inf, sqrt
from operator import mul
from typing import NamedTuple, TypeAlias

from estimation.gaussian import Gaussian, Row


class Assignment(NamedTuple):
    """x_i := keep x_i + factor x_j. What is added beside it, known input or noise, does not reach the adjoint."""

    i: int
    keep: float
    j: int
    factor: float


class Measurement(NamedTuple):
    """A scalar measurement of `row`, linearised where the filter stood."""

    row: Row
    gain: Sequence[float]  # (n,)
    innovation: float
    variance: float  # of the innovation


# A moment to be smoothed: for each watched state i one after the other x_i and row i of P, 1 + n numbers.
Mark: TypeAlias = "array[float]"


class Smoothed(NamedTuple):
    """Mean and standard deviation of the watched states, given all data."""

    x: tuple[float, ...]
    sigma: tuple[float, ...]


class TapedGaussian(Gaussian):
    """A state that remembers what is done to it, to be smoothed later. Its copies do not.

    Args:
        state: taken over.
        watched: indices of the states whose smoothed values are wanted.
    """

    def __init__(self, state: Gaussian, watched: Sequence[int]) -> None:
        super().__init__(state.x, state.p)
        self._watched = tuple(watched)
        self._tape: list[Assignment | Measurement | Mark] = []

    def mark(self) -> None:
        """Ask for the smoothed state at this moment."""
        self._tape.append(array("d", [value for i in self._watched for value in (self.x[i], *self.p[i])]))

    def take(self, keep: int = 0) -> list[Smoothed]:
        """Smooth the marks, oldest first, given all that is on the tape, and forget the tape up to the last of them.

        Args:
            keep: so many last marks stay on the tape, to be smoothed when more has followed.
        """
        adjoint = Adjoint(len(self.x))
        smoothed: list[Smoothed] = []
        end = 0  # of what is forgotten
        for place in range(len(self._tape) - 1, -1, -1):
            entry = self._tape[place]
            if isinstance(entry, Assignment):
                adjoint.before_assignment(entry)
            elif isinstance(entry, Measurement):
                adjoint.before_measurement(entry)
            elif keep > 0:
                keep -= 1
            else:
                end = end or place + 1
                smoothed.append(adjoint.smoothed(entry, self._watched))
        del self._tape[:end]
        smoothed.reverse()
        return smoothed

    def add(self, i: int, j: int, factor: float) -> None:
        """x_i += factor * x_j (i != j)."""
        super().add(i, j, factor)
        self._tape.append(Assignment(i, 1.0, j, factor))

    def scale(self, i: int, factor: float) -> None:
        """x_i *= factor."""
        super().scale(i, factor)
        self._tape.append(Assignment(i, factor, i, 0.0))

    def reset(self, i: int, mean: float, variance: float) -> None:
        """Forget all about state i and start it anew."""
        super().reset(i, mean, variance)
        self._tape.append(Assignment(i, 0.0, i, 0.0))

    def measure(self, row: Row, innovation: float, variance: float, hold: Sequence[int] = ()) -> float:
        """Scalar measurement of `row` with the given innovation; returns the innovation's variance.

        Where states are held, the moments before learn nothing: to them the measurement is a mere change of the state.
        """
        spread = self.covariance_with(row)
        s = super().measure(row, innovation, variance, hold)
        if s > 0.0:
            gain = array("d", [0.0 if i in hold else value / s for i, value in enumerate(spread)])
            told = (0.0, inf) if hold else (innovation, s)
            self._tape.append(Measurement(row, gain, *told))
        return s


class Adjoint:
    """What the operations after a moment tell of it: lambda (n,) and Lambda (n, n), symmetric; zero at the end."""

    def __init__(self, n: int) -> None:
        self._vector = [0.0] * n
        self._matrix = [[0.0] * n for _ in range(n)]

    def before_assignment(self, operation: Assignment) -> None:
        """lambda := F^T lambda, Lambda := F^T Lambda F, where F is the identity but for row i."""
        i, keep, j, factor = operation
        vector, matrix = self._vector, self._matrix
        value, line = vector[i], matrix[i]
        vector[i] = keep * value
        vector[j] += factor * value
        matrix[i] = [keep * a for a in line]
        matrix[j] = [a + factor * b for a, b in zip(matrix[j], line, strict=True)]
        for line in matrix:
            value = line[i]
            line[i] = keep * value
            line[j] += factor * value

    def before_measurement(self, operation: Measurement) -> None:
        """lambda := C^T lambda - h e / S, Lambda := C^T Lambda C + h h^T / S, where C = I - K h^T."""
        row, gain, innovation, variance = operation
        vector, matrix = self._vector, self._matrix
        pull = innovation / variance + _dot(gain, vector)
        reach = [_dot(gain, line) for line in matrix]
        weight = 1.0 / variance + _dot(gain, reach)
        for i, a in row:
            vector[i] -= a * pull
            matrix[i] = [b - a * c for b, c in zip(matrix[i], reach, strict=True)]
        for i, a in row:
            for line, value in zip(matrix, reach, strict=True):
                line[i] -= a * value
            for j, b in row:
                matrix[i][j] += a * b * weight

    def smoothed(self, mark: Mark, watched: Sequence[int]) -> Smoothed:
        """x - P lambda, and the roots of the diagonal of P - P Lambda P."""
        x, sigma = [], []
        size = 1 + len(self._vector)
        for place, i in enumerate(watched):
            mean, *row = mark[place * size : (place + 1) * size]
            learned = _dot(row, [_dot(row, line) for line in self._matrix])
            x.append(mean - _dot(row, self._vector))
            sigma.append(sqrt(max(row[i] - learned, 0.0)))
        return Smoothed(tuple(x), tuple(sigma))


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    total: float = sum(map(mul, a, b))
    return total
