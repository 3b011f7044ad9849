"""One row for each kind of fault: what was counted and said, how fast all was good again, what the estimate did.

    make faults

Simulated time: the figures are the same on every machine.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from daemon.offline.replaying.replay import replay
from drivers.virtual.faults import KINDS, BusFault, FaultScript, FrameFault, InterfaceFault, Jy901Fault, SerialFault
from estimation.records import CanState, Move, MoveKind
from tests.acceptance.fault_scene import Outcome, is_ill, play, without_faults

AT_S, FOR_S = 7.0, 2.0  # in the middle of the push, which ends at 12.7 s
NEEDED: dict[str, dict[str, Any]] = {
    "jump": {"offset_mm": 30.0},
    "drift": {"mm_s": 15.0},
    "slow_spi": {"extra_us": 800.0},
}
# These kinds show only when the part is tested or asked who it is: the supply dips a moment before.
NEEDS_A_RESTART = ("self_test_failure", "wrong_product_id")
CAN_FAULTS = (*get_args(FrameFault), *get_args(BusFault), *get_args(InterfaceFault))
JY901_FAULTS = (*get_args(SerialFault), *get_args(Jy901Fault))  # where a JY901 takes the place of the ADIS16448
S = 1_000_000_000
HEAD = f"""# What each fault does

Each kind of [fault](faults.md) by itself, for {FOR_S:g} s from second {AT_S:g} of a push (4.5 to 12.7 s), on the
virtual support in simulated time. *Counted* is what is more than in the same run without the fault; *said* is what
`status` and the log say, the first three sentences; *good again* counts from the end of the fault to the first good
sample and valid reading; *meanwhile* stands beside the numbers without the fault; *sigma* is the largest while it lasts
and 1 s after, without the fault in brackets; *state* is the displacement sensor's; *worst* is the largest error of the
provisional estimate in its own sigmas, to 2 s after the fault.

Made by `make faults`. The tests hold the program to it (`tests/acceptance/test_faults.py`).
"""


def script_of(kind: str) -> FaultScript:
    """A script with this one fault."""
    faults = [{"kind": kind, "at_s": AT_S, "for_s": FOR_S} | NEEDED.get(kind, {})]
    if kind in NEEDS_A_RESTART:
        faults.append({"kind": "unplugged", "at_s": AT_S + 0.1, "for_s": 0.3})
    return FaultScript.model_validate({"fault": faults})


@dataclass(frozen=True)
class Row:
    """What one fault did."""

    kind: str
    counted: dict[str, int]
    said: tuple[str, ...]
    good_again_s: float  # from the end of the fault to the first good sample and the first valid reading after it
    samples: int  # good ones while the fault lasted
    samples_without: int  # as many without the fault
    readings: int
    readings_without: int
    sigma_mm: float  # largest while it lasted and 1 s after
    sigma_without_mm: float
    states: tuple[str, ...]  # of the displacement sensor, other than ok and late
    ends: tuple[str, ...]  # of each move: error and sigma [mm]
    worst_sigmas: float  # error of the provisional estimate over its own sigma, to 2 s after the fault
    identical: bool


def row_of(kind: str, folder: Path) -> Row:
    """Play the fault and sum up."""
    path = folder / f"{kind}.mcap"
    # A quarter of the samples will do where they are not the subject.
    decimation = 2 if issubclass(KINDS[kind], CAN_FAULTS) else 0
    jy901 = issubclass(KINDS[kind], JY901_FAULTS)
    outcome = play(script_of(kind), recording=path, decimation_exponent=decimation, jy901=jy901)
    plain = without_faults(decimation, jy901=jy901)
    start, end = round(AT_S * S), round((AT_S + FOR_S) * S)
    lasting = [e for e in outcome.estimates if start <= e.t_ns < end + S]
    usual = [e for e in plain.estimates if start <= e.t_ns < end + S]
    moves = [outcome.moves[n] for n in sorted(outcome.moves)]
    return Row(
        kind,
        _more(outcome, plain),
        tuple(f"{part}: {condition.what}" for t_s, part, condition in outcome.said if is_ill(condition) and t_s > AT_S),
        max(_first_after(outcome.good_ns, end), _first_after([r.t_ns for r in outcome.valid], end)),
        _within(outcome.good_ns, start, end),
        _within(plain.good_ns, start, end),
        _within([r.t_ns for r in outcome.valid], start, end),
        _within([r.t_ns for r in plain.valid], start, end),
        max((e.sigma_m for e in lasting), default=float("nan")) * 1e3,
        max(e.sigma_m for e in usual) * 1e3,
        tuple(dict.fromkeys(str(e.can_state) for e in lasting if e.can_state not in (CanState.OK, CanState.LATE))),
        tuple(_end_of(move, outcome) for move in moves),
        outcome.worst_sigmas(start, end + 2 * S),
        replay(path).identical is True,
    )


def _end_of(move: Move, outcome: Outcome) -> str:
    truth = outcome.truth[0 if move.kind is MoveKind.PUSH else 1]
    return f"{move.kind} {(move.end_m - truth.end_m) * 1e3:+.1f} ± {move.sigma_m * 1e3:.1f}"


def _first_after(times: list[int], end: int) -> float:
    later = [t for t in times if t >= end]
    return (min(later) - end) / S if later else float("inf")


def _within(times: list[int], start: int, end: int) -> int:
    return sum(start <= t < end for t in times)


def _more(outcome: Outcome, plain: Outcome) -> dict[str, int]:
    """Counters that are higher than without the fault."""
    counted: dict[str, int] = {}
    for mine, usual in ((outcome.imu, plain.imu), (outcome.can, plain.can), (outcome.displacement, plain.displacement)):
        for name, value in mine.items():
            values = value.items() if isinstance(value, dict) else [(name, value)]
            for key, count in values:
                before = usual[name].get(key, 0) if isinstance(value, dict) else usual[name]
                if isinstance(count, int) and not isinstance(count, bool) and count > (before or 0):
                    counted[key] = count - (before or 0)
    return {k: v for k, v in counted.items() if k not in ("samples", "edge_reads", "received", "frames")}


def main() -> None:
    """Print the table as Markdown."""
    print(HEAD)
    kinds = sys.argv[1:] or list(KINDS)
    heads: tuple[str, ...] = (
        "fault",
        "counted",
        "said",
        "good again after",
        "samples, readings meanwhile",
        "sigma mm",
        "state",
        "worst",
    )
    heads += ("error of the moves mm", "replay")
    print("| " + " | ".join(heads) + " |\n|" + " --- |" * len(heads))
    with tempfile.TemporaryDirectory() as folder:
        for kind in kinds:
            row = row_of(kind, Path(folder))
            cells = [
                f"`{kind}`",
                ", ".join(f"{name} {count}" for name, count in row.counted.items()) or "-",
                "<br>".join(list(dict.fromkeys(row.said))[:3]) or "-",
                f"{row.good_again_s:.2f} s",
                f"{row.samples} of {row.samples_without}, {row.readings} of {row.readings_without}",
                f"{row.sigma_mm:.1f} ({row.sigma_without_mm:.1f})",
                ", ".join(row.states) or "ok",
                f"{row.worst_sigmas:.1f}",
                ", ".join(row.ends) or "none found",
                "identical" if row.identical else "DIFFERS",
            ]
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
