"""Two hundred random fault scripts: nothing dies, spins or goes back in time, no good sample is lost or doubled."""

from __future__ import annotations

import time
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from daemon.recording import topics
from daemon.recording.reader import Recording
from drivers.adis16448.burst import Burst
from drivers.virtual.faults import KINDS, FaultScript
from drivers.virtual.motion import PlannedMove
from estimation.records import TimeKind
from tests.acceptance.fault_scene import Outcome, edge_samples, play

SCRIPTS = 200
MOVES = (PlannedMove(3.0, 0.03, 0.01453), PlannedMove(5.5, 0.0, 0.03519))
LAST_FAULT_S = 5.0  # all is over then, and the pauses between tries have 6 s more to end
NEEDED: dict[str, dict[str, Any]] = {"jump": {"offset_mm": 25.0}, "drift": {"mm_s": -20.0}}
# These change what the part measures, or when: its samples are not those of the run without faults.
OF_THE_PART = {"brown_out", "unplugged", "replaced", "overrange", "repeated_samples"}
# Turns of the acquisition: one for each block, or each tenth of a second; restarts add some, doubled edges most.
TURNS_MORE, TURNS_TIMES = 200, 2.2
CPU_TIMES = 3.0


@st.composite
def scripts(draw: st.DrawFn) -> FaultScript:
    faults = []
    for kind in draw(st.lists(st.sampled_from(sorted(KINDS)), min_size=1, max_size=4)):
        at_s = draw(st.floats(0.0, LAST_FAULT_S - 0.05))
        for_s = draw(st.floats(0.02, LAST_FAULT_S - at_s))
        faults.append({"kind": kind, "at_s": at_s, "for_s": for_s} | NEEDED.get(kind, {}))
    return FaultScript.model_validate({"seed": draw(st.integers(0, 1000)), "fault": faults})


@cache
def plain(decimation: int) -> tuple[Outcome, float]:
    """The run without faults, and its processor time [s]."""
    began = time.process_time()
    outcome = play(None, script=MOVES, decimation_exponent=decimation)
    return outcome, time.process_time() - began


@pytest.fixture(scope="module")
def spent() -> dict[str, float]:
    """Processor time of all scripts, and of as many runs without faults."""
    return {"faulty": 0.0, "plain": 0.0}


@given(script=scripts())
@settings(
    max_examples=SCRIPTS,
    derandomize=True,
    deadline=None,
    database=None,
    phases=(Phase.generate,),
    suppress_health_check=(HealthCheck.function_scoped_fixture, HealthCheck.too_slow),
)
def test_whatever_goes_wrong_acquisition_outlives_it(
    script: FaultScript, spent: dict[str, float], tmp_path_factory: pytest.TempPathFactory
) -> None:
    # A few at the full rate; a sixteenth of the samples shows the same logic in a fraction of the time.
    decimation = 0 if script.seed % 50 == 7 else 4
    usual, usual_s = plain(decimation)
    path = tmp_path_factory.getbasetemp() / "random-faults.mcap" if script.seed % 5 == 3 else None
    if path is not None:
        path.unlink(missing_ok=True)
    began = time.process_time()
    outcome = play(script, script=MOVES, recording=path, decimation_exponent=decimation)
    spent["faulty"] += time.process_time() - began
    spent["plain"] += usual_s

    kinds: set[str] = {fault.kind for fault in script.fault}
    assert_time_never_goes_back(outcome)
    assert_no_good_sample_is_doubled_or_invented(outcome, usual, kinds)
    if path is not None:
        assert recorded_bursts(path) == outcome.bursts
    assert outcome.steps < TURNS_TIMES * usual.steps + TURNS_MORE
    assert_all_is_well_in_the_end(outcome)


def test_the_processor_does_not_spin_on_faults(spent: dict[str, float]) -> None:
    """Side by side, in the same runs as above."""
    assert spent["plain"] > 0, "run the test before this one too"
    assert spent["faulty"] < CPU_TIMES * spent["plain"]


def assert_time_never_goes_back(outcome: Outcome) -> None:
    for stream in (outcome.bursts, outcome.frames, outcome.readings, outcome.estimates, outcome.identities):
        times = [record.t_ns for record in stream]
        assert all(a <= b for a, b in pairwise(times))
    assert all(a.t_ns < b.t_ns for a, b in pairwise(outcome.good))


def assert_no_good_sample_is_doubled_or_invented(outcome: Outcome, usual: Outcome, kinds: set[str]) -> None:
    edges = edge_samples(outcome)
    assert len(edges) == len(set(edges))
    if kinds & OF_THE_PART or outcome.identities != usual.identities:
        return  # a part set up at another time filters from another sample on
    truth = {burst.t_ns: burst.words[1:] for burst in usual.bursts if burst.time_kind is TimeKind.EDGE}
    for burst in outcome.good:
        if burst.time_kind is TimeKind.EDGE and burst.t_ns in truth:
            assert burst.words[1:] == truth[burst.t_ns]


def recorded_bursts(path: Path) -> list[Burst]:
    recording = Recording(path)
    bursts = [record for _, record in recording.messages((topics.IMU_RAW,)) if isinstance(record, Burst)]
    assert (recording.lost, recording.damage) == (0, [])
    return bursts


def assert_all_is_well_in_the_end(outcome: Outcome) -> None:
    """The last second has good samples and valid readings again."""
    end_ns = outcome.estimates[-1].t_ns
    assert end_ns - outcome.good[-1].t_ns < 1e9
    assert end_ns - outcome.valid[-1].t_ns < 1e9
