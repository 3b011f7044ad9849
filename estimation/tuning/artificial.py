"""Paper A's artificial signal, section 4.1, with what the paper leaves open filled in six ways.

    u_k = 9.81 sin(t_k / 2); p, v by eq. (13) driven by u + w; y = p + noise; the filter gets u and y

Sampling time, length and noise are not printed. AS-1 is the reading that Table 2 is nearest to; the others move what a
good tuner must find: short record, wrong form of Q, small and large q/r, and the sizes of a roof support.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimation.arrays import FloatArray
from estimation.tuning.observed import Form, Observed, observed_at_every_step

G_M_S2 = 9.81  # as printed


@dataclass(frozen=True)
class Artificial:
    """One filling-in."""

    about: str
    form: Form
    dt_s: float
    n: int
    var_w: float  # of the acceleration
    var_v: float  # of the reading


ARTIFICIAL = {
    "AS-1": Artificial("default", "BqB", 0.1, 1001, 1.0, 1.0),
    "AS-2": Artificial("short record", "BqB", 0.01, 1001, 1.0, 1.0),
    "AS-3": Artificial("wrong form of Q", "qI", 0.1, 1001, 1.0, 1.0),
    "AS-4": Artificial("small ratio", "BqB", 0.1, 1001, 1e-4, 1.0),
    "AS-5": Artificial("large ratio", "BqB", 0.1, 1001, 1e4, 1.0),
    "AS-6": Artificial("roof support", "BqB", 0.01, 3001, 0.01, 2.5e-5),
}


@dataclass(frozen=True)
class Signal:
    """One draw, (n,) each: input, true position, reading."""

    u: FloatArray
    truth: FloatArray
    y: FloatArray


def signal(case: Artificial, seed: int) -> Signal:
    """The draw of this seed: first the n values of w, then the n of the reading's noise."""
    rng = np.random.default_rng(seed)
    w = np.sqrt(case.var_w) * rng.standard_normal(case.n)
    noise = np.sqrt(case.var_v) * rng.standard_normal(case.n)
    u = G_M_S2 * np.sin(0.5 * case.dt_s * np.arange(case.n))
    a = u + w
    a[0] = 0.0  # the first step is the state at the beginning
    v = np.cumsum(case.dt_s * a)
    p = np.cumsum(case.dt_s * np.concatenate([[0.0], v[:-1]]) + 0.5 * case.dt_s**2 * a)
    return Signal(u, p, p + noise)


def observed(case: Artificial, seed: int) -> Observed:
    """The draw as the tuners take it, with its truth."""
    drawn = signal(case, seed)
    return observed_at_every_step(drawn.u, drawn.y, case.dt_s, drawn.truth, case.form)
