from __future__ import annotations

import pytest

from estimation.belief import Phase
from estimation.mskf import Filter
from estimation.settings import EstimatorSettings, SupportSettings
from estimation.supervision import Supervisor
from estimation.track import Step, Track

STILL = (0.0, 0.0, 0.0)


def track(phase: Phase) -> Track:
    made = Track.begin(Filter.start(0.1, 0.001, SupportSettings(), EstimatorSettings()))
    made.phase = phase
    return made


@pytest.mark.parametrize(
    ("phase", "vibration_m_s2", "upset"),
    [
        (Phase.REST, 1.1, False),
        (Phase.REST, 1.3, True),
        (Phase.CRUISE, 1.3, False),  # a rough floor
        (Phase.CRUISE, 1.9, True),
    ],
)
def test_a_known_move_may_shake_more_than_a_rest(phase: Phase, vibration_m_s2: float, upset: bool) -> None:
    step = Step(10**9, 0.01, (0.0, 0.0, 9.8), STILL, (0.0, 0.0, 9.8), vibration_m_s2=vibration_m_s2)
    assert Supervisor().upset(step, track(phase)) is upset


def test_turning_faster_than_any_support_tilts_is_upset_in_every_phase() -> None:
    step = Step(10**9, 0.01, (0.0, 0.0, 9.8), (0.0, 0.4, 0.0), (0.0, 0.0, 9.8))
    assert all(Supervisor().upset(step, track(phase)) for phase in (Phase.REST, Phase.CRUISE))
