"""What a recording shows, in a line for people in a hurry, and the verdict on each move."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import isnan

import numpy as np

from daemon.offline.report.collecting import STATES, Collector
from daemon.offline.report.reduction import runs
from daemon.offline.report.times import Clock
from daemon.offline.reviewing.reference_errors import SIGMAS_95
from daemon.offline.reviewing.review import Review
from daemon.offline.reviewing.smoothed_moves import SmoothedMove
from daemon.recording.topics import SETTLED
from estimation.records import CanState, Move, MoveKind, Tier

STANDS_NS = 1_500_000_000  # after the start of deceleration
_UNCERTAIN_MM = 30.0  # 95 %
_WORTH_A_WORD_NS = 1_000_000_000  # of an ill sensor


@dataclass(slots=True, frozen=True)
class MoveFinding:
    """One move with what lies beside it; millimetres."""

    move: Move
    smoothed: SmoothedMove | None
    largest_innovation_mm: float  # NaN without a reading in it
    reference_mm: float  # where the reference sensor saw it end; NaN without
    others_mm: dict[str, float]  # where other methods say that it ended
    is_good: bool
    verdict: str


def move_findings(reviewed: Review, collected: Collector) -> list[MoveFinding]:
    """All moves, in order."""
    return [_finding(move, reviewed, collected) for move in reviewed.replayed.moves]


def _finding(move: Move, reviewed: Review, collected: Collector) -> MoveFinding:
    steps = collected.steps
    t_ns = np.frombuffer(steps.t_ns, dtype=np.int64)
    first, last = np.searchsorted(t_ns, (move.onset_ns, move.stop_ns + STANDS_NS))
    innovations = np.frombuffer(steps.innovation, dtype=np.float32)[first:last]
    innovations = innovations[np.isfinite(innovations)]
    largest = float(innovations[np.abs(innovations).argmax()]) if len(innovations) else float("nan")
    reference_mm = _reference_at(collected, move.stop_ns + STANDS_NS)
    others = {name: _end_nearest(move, course.moves) for name, course in collected.others.items()}
    is_good, verdict = _verdict(move, reference_mm)
    return MoveFinding(move, reviewed.smoothed_moves.of(move), largest, reference_mm, others, is_good, verdict)


def _reference_at(collected: Collector, t_ns: int) -> float:
    times = np.frombuffer(collected.reference.t_ns, dtype=np.int64)
    good = np.frombuffer(collected.reference.word, dtype=np.uint8) == 0
    near = np.flatnonzero(good & (np.abs(times - t_ns) < 200_000_000))
    return float(np.frombuffer(collected.reference.value, dtype=np.float32)[near].mean()) if len(near) else float("nan")


def _end_nearest(move: Move, moves: list[Move]) -> float:
    """End of the move of the same kind that met this one in time; NaN if the method saw none."""
    met = [m for m in moves if m.kind is move.kind and m.onset_ns < move.stop_ns and m.stop_ns > move.onset_ns]
    return met[-1].end_m * 1e3 if met else float("nan")


def _verdict(move: Move, reference_mm: float) -> tuple[bool, str]:
    error_mm = move.end_m * 1e3 - reference_mm
    if move.tier is not Tier.SETTLED:
        return False, "still open at the end of the recording"
    if isnan(move.sigma_m):
        return True, "no uncertainty stated by this method"
    if abs(error_mm) > SIGMAS_95 * move.sigma_m * 1e3 + 1.0:
        return False, f"{error_mm:+.1f} mm off the reference"
    if SIGMAS_95 * move.sigma_m * 1e3 > _UNCERTAIN_MM:
        return False, "uncertain"
    if move.can_state is CanState.ABSENT:
        return True, "inertial sensor alone"
    if move.can_state is not CanState.OK:
        return False, f"displacement sensor {words(move.can_state)}"
    return True, "good"


def words(state: CanState | str) -> str:
    """A state as people read it."""
    return str(state).replace("_", " ")


def summary(
    reviewed: Review, collected: Collector, findings: list[MoveFinding], clock: Clock
) -> list[tuple[bool, str]]:
    """The verdict on the recording in parts, the most important first, each with whether it is good."""
    said = [(bool(reviewed.replayed.moves), _moves_in_words(reviewed.replayed.moves))]
    doubtful = sum(not finding.is_good for finding in findings)
    if doubtful:
        said.append((False, f"{doubtful} of them doubtful" if len(findings) > 1 else "it is doubtful"))
    said += _sensor_in_words(collected, clock)
    gaps = len(reviewed.gaps) + reviewed.gaps_not_shown
    if gaps:
        said.append((False, _counted(gaps, "gap") + " in the inertial samples"))
    bad = sum(reviewed.faults.values())
    if bad:
        said.append((False, f"{_counted(bad, 'bad sample')} left out"))
    errors = sum(collected.error_frames.values())
    if errors:
        said.append((False, _counted(errors, "CAN error frame")))
    if reviewed.lost:
        said.append((False, f"{_counted(reviewed.lost, 'message')} lost"))
    if not reviewed.complete:
        said.append((False, "the file was cut short or is still being written"))
    if reviewed.replayed.identical is False:
        said.append((False, "recorded estimates NOT reproduced"))
    if not reviewed.messages[SETTLED] and not len(collected.steps.t_ns):
        said.append((False, "no estimate: too few inertial samples"))
    return said


def _moves_in_words(moves: list[Move]) -> str:
    if not moves:
        return "no moves"
    kinds = Counter(move.kind for move in moves)
    return ", ".join(_counted(kinds[kind], str(kind)) for kind in MoveKind if kinds[kind])


def _counted(count: int, what: str) -> str:
    plural = "es" if what.endswith(("sh", "s")) else "s"
    return f"{count} {what}{'' if count == 1 else plural}"


def _sensor_in_words(collected: Collector, clock: Clock) -> list[tuple[bool, str]]:
    """How the displacement sensor was, apart from the beginning, when no reading can have come yet."""
    steps = collected.steps
    found = runs(np.frombuffer(steps.t_ns, dtype=np.int64), np.frombuffer(steps.state, dtype=np.uint8))
    states = [(begin, end, STATES[code]) for begin, end, code in found]
    if not states:
        return []
    begin_ns, _, last = states[-1]
    if last is CanState.ABSENT and len(states) == 1:
        return [(True, "no displacement sensor")]
    ill: Counter[CanState] = Counter()
    for begin, end, state in states:
        if state not in (CanState.OK, CanState.ABSENT):
            ill[state] += end - begin
    if last is not CanState.OK and last is not CanState.ABSENT:
        return [(False, f"displacement sensor {words(last)} since {clock.minute(begin_ns)}")]
    if sum(ill.values()) >= _WORTH_A_WORD_NS:
        told = ", ".join(f"{words(state)} for {ns * 1e-9:.1f} s" for state, ns in ill.most_common())
        return [(False, f"displacement sensor was {told}")]
    return [(True, "displacement sensor good")]
