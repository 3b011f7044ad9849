"""A recorded or simulated motion as the two-state filter of paper A sees it, compressed to one step per reading.

Between two readings the filter only predicts, and what the input adds to [p, v] does not depend on Q or R; so a record
of any rate becomes one row per reading: interval, what the input adds, and how a unit of q enters the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from estimation.arrays import FloatArray

Form = Literal["BqB", "qI"]  # q B B^T: noise of the acceleration (the text); q I: eq. (2) literally
FORMS: tuple[Form, ...] = ("BqB", "qI")
READINGS_WANTED = 8


@dataclass(frozen=True)
class Observed:
    """Rows (n,), one per reading; lengths in any one unit, seconds. The filter starts at x = 0, P = 0."""

    dt_s: FloatArray
    added: FloatArray  # (n, 2) to position and velocity by the input since the last reading
    noise: FloatArray  # (n, 3) covariance pp, pv, vv that a unit of q adds since then
    y: FloatArray  # readings
    truth: FloatArray | None  # true position at the readings

    @property
    def is_uniform(self) -> bool:
        """Whether all steps are alike: then the gain settles, and a fixed linear filter does for a scan."""
        even_noise = (np.ptp(self.noise, axis=0) <= 1e-9 * self.noise[0]).all()
        return bool(np.ptp(self.dt_s) < 1e-9 * self.dt_s[0] and even_noise)


def observed_at_every_step(
    u: FloatArray, y: FloatArray, dt_s: float, truth: FloatArray | None = None, form: Form = "BqB"
) -> Observed:
    """Paper A's case: an input and a reading at each of (n,) steps of `dt_s`; the first of each is not used.

    Raises ValueError, in one sentence, for data that nothing can be learned from.
    """
    arrays = {"u": u, "y": y} | ({} if truth is None else {"truth": truth})
    arrays = {name: np.asarray(values, dtype=np.float64) for name, values in arrays.items()}
    for name, values in arrays.items():
        if values.ndim != 1 or len(values) != len(arrays["u"]):
            raise ValueError(
                f"{name} has shape {values.shape}, u has {arrays['u'].shape}: one value per step is wanted"
            )
    if not (np.isfinite(dt_s) and dt_s > 0):
        raise ValueError(f"dt is {dt_s}: seconds above 0 are wanted")
    n = len(arrays["u"]) - 1
    if n >= 0:
        arrays = {name: values[1:] for name, values in arrays.items()}
    h = 0.5 * dt_s * dt_s
    unit = (h * h, h * dt_s, dt_s * dt_s) if form == "BqB" else (1.0, 0.0, 1.0)
    return checked(
        Observed(
            np.full(max(n, 0), dt_s),
            arrays["u"][:, None] * np.array([h, dt_s]),
            np.tile(unit, (max(n, 0), 1)),
            arrays["y"],
            arrays.get("truth"),
        )
    )


def observed_by_readings(
    t_s: FloatArray, a: FloatArray, seen_s: FloatArray, seen: FloatArray, truth: FloatArray | None, form: Form
) -> Observed:
    """A recording: acceleration (n,) at `t_s`, readings (m,) at `seen_s`, each taken in at the first sample after it.

    Several readings at one sample count as the last of them. Raises ValueError as `observed_at_every_step`.
    """
    at = np.searchsorted(t_s, seen_s)
    keep = (at > 0) & (at < len(t_s))
    keep[:-1] &= np.diff(at) > 0
    at, seen = at[keep], seen[keep]
    dt = np.diff(t_s, prepend=t_s[:1])
    rows = []
    p = v = pp = pv = vv = 0.0
    marks = set(at.tolist())
    begun_s = float(t_s[0])
    for i, (t, h, u) in enumerate(zip(t_s.tolist(), dt.tolist(), a.tolist(), strict=True)):
        half = 0.5 * h * h
        p, v = p + h * v + half * u, v + h * u
        pp, pv = pp + 2 * h * pv + h * h * vv, pv + h * vv
        if form == "BqB":
            pp, pv, vv = pp + half * half, pv + half * h, vv + h * h
        else:
            pp, vv = pp + 1.0, vv + 1.0
        if i in marks:
            rows.append((t - begun_s, p, v, pp, pv, vv))
            p = v = pp = pv = vv = 0.0
            begun_s = t
    table = np.array(rows).reshape(-1, 6)
    return checked(Observed(table[:, 0], table[:, 1:3], table[:, 3:6], seen, None if truth is None else truth[keep]))


def checked(observed: Observed) -> Observed:
    """The same. Raises ValueError, in one sentence, for data that nothing can be learned from."""
    if len(observed.y) < READINGS_WANTED:
        raise ValueError(f"{len(observed.y)} readings of the displacement are too few: {READINGS_WANTED} are wanted")
    for name, values in (("input", observed.added), ("displacement", observed.y), ("truth", observed.truth)):
        if values is not None and not np.isfinite(values).all():
            raise ValueError(f"the {name} has {int((~np.isfinite(values)).sum())} values that are no finite number")
    if np.ptp(observed.y) == 0:
        raise ValueError(f"the displacement is constant ({observed.y[0]:g}): there is no motion to tune on")
    return observed
