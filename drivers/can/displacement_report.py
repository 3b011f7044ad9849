"""How a displacement source on CAN is, for people: counters, and what is wrong in words."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from drivers.can.cia301 import NODE_STATES, OPERATIONAL, STOPPED, emergency_words
from drivers.can.cia406 import NodeWatch
from drivers.can.dbc import DisplacementSignal
from drivers.can.frame_watch import CounterWatch, FrameRate
from drivers.condition import OK, Condition, Wellness
from estimation.records import ReadingFault

TOLD_NS = 3_000_000_000  # a single bad frame is told for so long

_ADVICE = {
    ReadingFault.MALFORMED: "compare the frames with the DBC file (candump shows them); correct `dbc`, `message` or "
    "`arbitration_id`",
    ReadingFault.CHECKSUM: "check `checksum` and `checksum_signal`; if only some frames fail, look for a second sender "
    "of this identifier",
    ReadingFault.REPEATED: "restart the controller or the gateway before it; if it is well, `counter_signal` names "
    "the wrong signal",
    ReadingFault.INVALID: "check magnet, cable and supply of the sensor; its manual explains the code",
    ReadingFault.OUT_OF_RANGE: "check the sensor; if it is well, correct `unit`, the scale in the DBC file, "
    "`minimum_mm` or `maximum_mm`",
}

_COMMUNICATION_ADVICE = (
    "its position still counts; check cable, termination, bit rate and load of the bus, and the network's master"
)


@dataclass(slots=True, frozen=True)
class DisplacementReport:
    """One source at one time; the numbers count from the start of the program."""

    condition: Condition
    frames: int  # of the message, bad ones included
    malformed: int
    checksum: int
    repeated: int
    invalid: int
    out_of_range: int
    lost_frames: int  # left out by the message counter
    crowded_frames: int  # that came far more often than usual and with wrong counters or checksums
    emergencies: int
    malformed_emergencies: int
    rate_hz: float | None  # of the last second or so, None while there is none
    age_s: float | None  # of the last frame, None before the first

    def counters(self) -> dict[str, Any]:
        """Everything but the condition, for JSON."""
        numbers = asdict(self)
        del numbers["condition"]
        return numbers


@dataclass(slots=True, frozen=True)
class Lapse:
    """What was wrong with a frame."""

    t_ns: int
    fault: ReadingFault
    what: str


def source_condition(
    source: DisplacementSignal,
    node: NodeWatch,
    rate: FrameRate,
    counter: CounterWatch,
    lapse: Lapse | None,
    now_ns: int,
    timeout_ns: int,
) -> Condition:
    """What ails the source most, in words."""
    if rate.last_ns is None or now_ns - rate.last_ns > timeout_ns:
        return _silence(source, node, rate.last_ns, now_ns, timeout_ns)
    if lapse is not None and now_ns - lapse.t_ns < TOLD_NS:
        return Condition(Wellness.ILL, lapse.what, _ADVICE[lapse.fault])
    if rate.is_crowded and rate.recent_hz is not None and rate.usual_hz is not None:
        return Condition(
            Wellness.ILL,
            f"frames {source.frame_id} come {rate.recent_hz:.0f} times a second instead of {rate.usual_hz:.0f}: two "
            "senders use one identifier, or the sender runs wild",
            "look for the second sender of this identifier; if the rate was changed on purpose, restart this program",
        )
    if counter.lost_ns is not None and now_ns - counter.lost_ns < TOLD_NS:
        return Condition(
            Wellness.ILL,
            f"the message counter jumps: {counter.lost_frames} frames {source.frame_id} were lost",
            "look for a second sender of this identifier, an overloaded bus or a loose plug",
        )
    if node.communication_code is not None:
        words = emergency_words(node.communication_code, node.error_register)
        return Condition(Wellness.ILL, f"the source says: {words}", _COMMUNICATION_ADVICE)
    return OK


def _silence(
    source: DisplacementSignal, node: NodeWatch, last_ns: int | None, now_ns: int, timeout_ns: int
) -> Condition:
    if node.error_code is not None:
        words = emergency_words(node.error_code, node.error_register)
        return _waiting(
            f"the source says: {words}, and sends no position {source.frame_id}", _ADVICE[ReadingFault.INVALID]
        )
    # An operational node of before the silence may be dead by now; one that said that it is not explains the silence.
    proof_ns = timeout_ns if node.state == OPERATIONAL else 0
    if node.state is not None and (last_ns is None or node.heard_ns - last_ns > proof_ns):
        state = NODE_STATES.get(node.state, f"in state {node.state}")
        heard = f"node {source.node_id} is {state} by its heartbeat of {(now_ns - node.heard_ns) * 1e-9:.1f} s ago"
        if node.state == OPERATIONAL:
            return _waiting(
                f"{heard}, but sends no position {source.frame_id}",
                "switch its cyclic PDO on (event timer 1800h:05, or cyclic timer 6200h), or correct `arbitration_id`",
            )
        cause = "was stopped" if node.state == STOPPED else "waits to be started"
        return _waiting(
            f"{heard}: it {cause} and sends no position",
            "let the network's master start it (NMT start), or set the sensor to start by itself (object 1F80h); this "
            "program sends no commands",
        )
    if node.communication_code is not None:
        words = emergency_words(node.communication_code, node.error_register)
        return _waiting(f"the source says: {words}, and sends no position {source.frame_id}", _COMMUNICATION_ADVICE)
    advice = "check that the controller is switched on, its cable, the bit rate and the identifier (candump shows it)"
    if last_ns is None:
        return _waiting(f"no frame {source.frame_id} yet", advice)
    return _waiting(f"no frame {source.frame_id} for {(now_ns - last_ns) * 1e-9:.1f} s", advice)


def _waiting(what: str, advice: str) -> Condition:
    return Condition(Wellness.WAITING, what, advice)
