"""What was learned, in the units and words that leave the program."""

from __future__ import annotations

import json

import pytest

from daemon.rows import learned_row, learned_words
from estimation.gaussian import Gaussian
from estimation.learned import Learned, Machine
from estimation.settings import SupportSettings

SIGMA = (0.001, 0.0004, 0.0006, 0.005, 0.00012, 0.0003)
LEARNED = Learned.of(
    Machine.of(SupportSettings()),
    Gaussian.diagonal((-0.0194, 0.0012, -0.00041, 0.004, 0.014612, 0.0354), SIGMA),
    4,
    1,
    0.0028,
)


def test_what_was_learned_has_a_unit_in_every_name() -> None:
    row = learned_row(LEARNED)
    assert row is not None
    assert row["push"] == pytest.approx({"speed_mm_s": 14.612, "sigma_mm_s": 0.12, "moves": 4})
    assert row["retract"] == pytest.approx({"speed_mm_s": 35.4, "sigma_mm_s": 0.3, "moves": 1})
    assert row["sensor"] == pytest.approx(
        {
            "scale_percent": -1.94,
            "scale_sigma_percent": 0.1,
            "offset_mm": 1.2,
            "offset_sigma_mm": 0.4,
            "bow_mm": -0.41,
            "bow_sigma_mm": 0.6,
            "latency_ms": 4.0,
            "latency_sigma_ms": 5.0,
            "noise_mm": 2.8,
            "calibrations": 5,
        }
    )
    assert json.loads(json.dumps(row)) == row


def test_what_was_learned_is_told_in_one_line() -> None:
    assert learned_words(learned_row(LEARNED)) == (
        "push 14.61 ± 0.12 mm/s (from 4 moves), retract 35.40 ± 0.30 mm/s (from 1 move), "
        "sensor scale -1.9 ± 0.1 %, offset +1.2 ± 0.4 mm, bow -0.4 ± 0.6 mm, latency +4.0 ± 5.0 ms"
    )


def test_nothing_learned_is_told_as_such() -> None:
    assert learned_row(None) is None
    assert learned_words(None) == "nothing learned yet"
