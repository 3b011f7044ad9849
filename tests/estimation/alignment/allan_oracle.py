"""Allan deviations by allantools, which the tests compare ours with. It is in no environment of this program:

    python -m venv /tmp/oracle && /tmp/oracle/bin/pip install allantools==2024.06
    /tmp/oracle/bin/python -m tests.estimation.alignment.allan_oracle

from the root of the repository writes `data/allantools.json` anew.
"""

from __future__ import annotations

import csv
import gzip
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

STORED = Path(__file__).parent / "data" / "allantools.json"
BROAD = Path(__file__).parents[2] / "data" / "broad" / "slow_translation_34_54_s.csv.gz"
RATE_HZ, SAMPLES = 100.0, 20_000
BROAD_RATE_HZ, BROAD_RESTS = 2000 / 7, 1700


def made() -> NDArray[np.float64]:
    """White noise, a random walk and a constant (SAMPLES,)."""
    rng = np.random.default_rng(952)
    white, steps = rng.standard_normal((2, SAMPLES))
    return np.asarray(0.3 * white + 0.01 * np.cumsum(steps) + 9.8)


def measured() -> NDArray[np.float64]:
    """Vertical force of a real sensor at rest, in steps of its resolution (BROAD_RESTS,)."""
    with gzip.open(BROAD, "rt") as stream:
        return np.array([float(row["accel_z_m_s2"]) for row in csv.DictReader(stream)][:BROAD_RESTS])


def main() -> None:
    """Write the file."""
    import allantools  # type: ignore[import-not-found, unused-ignore]

    stored: dict[str, object] = {"about": f"Overlapping Allan deviations by allantools {allantools.__version__}."}
    for name, signal, rate_hz in (("made", made(), RATE_HZ), ("measured", measured(), BROAD_RATE_HZ)):
        sizes = np.unique(np.rint(10 ** (np.arange(40) / 8)).astype(int))
        sizes = sizes[sizes <= len(signal) // 3]
        tau_s, deviation, _, _ = allantools.oadev(signal, rate_hz, "freq", sizes / rate_hz)
        stored[name] = {"tau_s": tau_s.tolist(), "deviation": deviation.tolist()}
    STORED.write_text(json.dumps(stored, indent=1) + "\n")


if __name__ == "__main__":
    main()
