"""What passes on the bus: which identifiers, the configured displacement among them, and nobody on ours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import can

from daemon.doctor.report import Check, fault, not_checked, ok, warning
from drivers.can.displacement import DisplacementDecoder
from drivers.can.error_tally import ErrorTally
from drivers.can.frame import Frame, FrameId
from drivers.can.interface import to_frame
from drivers.can.settings import CanSettings
from drivers.clock import Clock
from drivers.condition import Wellness
from estimation.records import Displacement

FRAMES, OURS = "CAN frames", "estimate identifier"
_PAUSE_S = 0.002
_SHOWN = 8
_MANY_ERRORS = 10
_STUCK_READINGS = 10
_BAD_SHARE = 0.1
_BEYOND_MM = 40.0  # of the stroke, as the estimator bears
_CROWDED = 1.5  # times our own rate
_RIGHT_CHANNEL = "and check channel in [can]"


@dataclass(slots=True)
class Seen:
    """One identifier."""

    count: int = 0
    lengths: set[int] = field(default_factory=set)


@dataclass(slots=True)
class Traffic:
    """What a few seconds brought."""

    ours: FrameId | None = None  # of the estimate: it says nothing about the bus, nor about the displacement
    seconds: float = 0.0
    end_ns: int = 0
    by_id: dict[FrameId, Seen] = field(default_factory=dict)
    errors: ErrorTally = field(default_factory=ErrorTally)
    error_frames: int = 0
    readings: list[Displacement] = field(default_factory=list)

    def take(self, frame: Frame) -> None:
        """Count a frame."""
        if frame.is_error:
            self.error_frames += 1
            self.errors.add(frame)
            return
        seen = self.by_id.setdefault(frame.frame_id, Seen())
        seen.count += 1
        seen.lengths.add(len(frame.data))

    @property
    def others(self) -> dict[FrameId, Seen]:
        """What is not the estimate."""
        return {one: seen for one, seen in self.by_id.items() if one != self.ours}

    def rate_hz(self, frame_id: FrameId) -> float:
        """Frames a second of that identifier."""
        seen = self.by_id.get(frame_id)
        return seen.count / self.seconds if seen and self.seconds else 0.0

    def words(self) -> str:
        """The identifiers with their rates, the busiest first."""
        order = sorted(self.by_id, key=lambda one: -self.by_id[one].count)
        shown = [f"{one} ({self.rate_hz(one):.1f}/s)" for one in order[:_SHOWN]]
        return ", ".join(shown) + (f" and {len(order) - _SHOWN} more" if len(order) > _SHOWN else "")


def listen(
    bus: can.BusABC,
    clock: Clock,
    seconds: float,
    decoders: list[DisplacementDecoder],
    play: Callable[[], None],
    ours: FrameId | None = None,
) -> Traffic:
    """Take in what comes; `play` lets a virtual controller of this process send. Raises CanError, OSError."""
    traffic = Traffic(ours)
    begin_ns = clock.now_ns()
    end_ns = begin_ns + round(seconds * 1e9)
    while clock.now_ns() < end_ns:
        play()
        while (message := bus.recv(0)) is not None and clock.now_ns() < end_ns:
            frame = to_frame(message, clock.now_ns())
            traffic.take(frame)
            traffic.readings += [one for decoder in decoders if (one := decoder.decode(frame)) is not None]
        clock.sleep(_PAUSE_S)
    traffic.end_ns = clock.now_ns()
    traffic.seconds = (traffic.end_ns - begin_ns) * 1e-9
    return traffic


def judge_frames(traffic: Traffic, settings: CanSettings, *, is_wired: bool = True) -> Check:
    """Whether anything comes at all, and whether the bus is sound; a virtual interface has no wires to look at."""
    figures = {
        "identifiers": {str(one): round(traffic.rate_hz(one), 2) for one in traffic.by_id},
        "error_frames": traffic.error_frames,
        "seconds": round(traffic.seconds, 2),
    }
    if not traffic.others:
        said = f" but {traffic.words()}, our own estimate" if traffic.by_id else ""
        if traffic.error_frames:
            said += f"; {traffic.error_frames} error frames, the last: {traffic.errors.last}"
        advice = "switch the controller on, look at CANH/CANL, termination and bit rate, "
        if not is_wired:
            advice = f"start what sends on {settings.channel}, which is virtual, such as `ramstroke sim`, "
        found = f"no frame at all on {settings.channel} in {traffic.seconds:.0f} s{said}"
        return fault(FRAMES, found, f"{advice}{_RIGHT_CHANNEL}", **figures)
    found = f"in {traffic.seconds:.0f} s {traffic.words()}"
    if traffic.error_frames >= _MANY_ERRORS:
        found = f"{traffic.error_frames} error frames, the last: {traffic.errors.last}; {found}"
        advice = "check CANH, CANL, the 120 ohm resistors at both ends and the bit rate"
        return warning(FRAMES, found, advice, **figures)
    return ok(FRAMES, found, **figures)


def judge_displacement(
    name: str, decoder: DisplacementDecoder, traffic: Traffic, stroke_mm: float, is_reference: bool = False
) -> Check:
    """Whether the configured frame comes, is whole, and holds a believable value."""
    source, report = decoder.source, decoder.report(traffic.end_ns)
    rate_hz = traffic.rate_hz(source.frame_id)
    values = [one.value_m * 1e3 for one in traffic.readings if one.is_reference is is_reference and one.valid]
    figures = {
        "identifier": str(source.frame_id),
        "rate_hz": round(rate_hz, 2),
        "readings": len(values),
        "least_mm": round(min(values), 2) if values else None,
        "largest_mm": round(max(values), 2) if values else None,
        **{key: count for key, count in report.counters().items() if key not in ("rate_hz", "age_s")},
    }
    if not report.frames:
        return _missing(name, decoder, traffic, figures)
    bad = report.malformed + report.checksum + report.repeated + report.invalid + report.out_of_range
    if bad or report.condition.word is not Wellness.OK:
        what, advice = report.condition.what or f"{bad} of {report.frames} frames were bad", report.condition.advice
        found = f"{what}; {bad} of {report.frames} frames are not believed"
        make = fault if bad > _BAD_SHARE * report.frames else warning
        return make(name, found, advice or "look for a second sender of this identifier", **figures)
    if not values:
        advice = "correct message, signal or arbitration_id: this page of the message holds no displacement"
        return fault(name, f"{report.frames} frames {source.frame_id}, but no reading in them", advice, **figures)
    who = f"{source.frame_id}, {rate_hz:.1f} a second"
    return _judge_values(name, values, who, stroke_mm, figures, is_reference)


def _judge_values(
    name: str, values: list[float], who: str, stroke_mm: float, figures: dict[str, object], is_reference: bool
) -> Check:
    least, largest = min(values), max(values)
    if not -_BEYOND_MM <= least <= largest <= stroke_mm + _BEYOND_MM:
        advice = "correct unit or the scale in the DBC file, or stroke_mm in [support]"
        found = f"{who}: {least:.1f} to {largest:.1f} mm, outside the stroke of {stroke_mm:g} mm"
        return warning(name, found, advice, **figures)
    if least == largest and len(values) >= _STUCK_READINGS and not is_reference:
        # Of a ram that rests this is no evidence; beside a move it would be, and the daemon judges that all the time.
        found = f"{who}: {least:.1f} mm, whole and valid; all {len(values)} readings are equal, as of a quiet sensor at"
        return ok(name, f"{found} rest: whether it follows the ram, only a move shows", **figures)
    return ok(name, f"{who}: {least:.1f} to {largest:.1f} mm, whole and valid", **figures)


def _missing(name: str, decoder: DisplacementDecoder, traffic: Traffic, figures: dict[str, object]) -> Check:
    source, condition = decoder.source, decoder.report(traffic.end_ns).condition
    if not traffic.others:
        return not_checked(name, "nothing was heard that could be it", "mend what stands above first", **figures)
    alike = [
        str(one)
        for one, seen in traffic.others.items()
        if seen.lengths == {source.message.length} and one.is_extended == source.frame_id.is_extended
    ]
    advice = f"correct preset, arbitration_id, node_id or dbc in [can.{name}], or let the controller send it"
    if alike:
        advice = (
            f"set arbitration_id in [can.{name}] to {' or '.join(alike[:_SHOWN])}, which has the right length, if that "
            "is the sender's; else correct preset, node_id or dbc"
        )
    if source.node_id is not None and "heartbeat" in condition.what:
        advice = condition.advice
    return fault(name, f"{condition.what}, but {traffic.words()}", advice, **figures)


def judge_own_identifier(traffic: Traffic, settings: CanSettings, *, daemon_sends: bool | None) -> Check | None:
    """Whether somebody else uses the identifier of the estimate frame; None if none is to be sent.

    `daemon_sends`: None if nobody knows whether a daemon runs.
    """
    publish = settings.publish
    if not publish.enabled:
        return None
    ours = own_identifier(settings)
    rate_hz, own_hz = traffic.rate_hz(ours), 1e3 / publish.period_ms
    advice = "choose a free arbitration_id in [can.publish]: two senders of one identifier destroy each other's frames"
    if daemon_sends is None and 0.0 < rate_hz <= _CROWDED * own_hz:
        return not_checked(OURS, f"{ours} comes {rate_hz:.1f} times a second, perhaps from a running daemon")
    if daemon_sends:
        if not rate_hz:
            look = "mend what stands above first; `ramstroke status` tells whether there is an estimate to be sent"
            return warning(OURS, f"{ours} is to be sent by the running daemon, but does not come", look, rate_hz=0.0)
        if rate_hz <= _CROWDED * own_hz:
            return ok(OURS, f"{ours} comes {rate_hz:.1f} times a second, from the running daemon", rate_hz=rate_hz)
        return fault(
            OURS, f"{ours} comes {rate_hz:.1f} times a second, the daemon sends {own_hz:g}", advice, rate_hz=rate_hz
        )
    if rate_hz:
        return fault(OURS, f"{ours} is in use: {rate_hz:.1f} frames a second", advice, rate_hz=rate_hz)
    return ok(OURS, f"{ours} is free")


def own_identifier(settings: CanSettings) -> FrameId:
    """Of the estimate frame, whether it is to be sent or not."""
    return FrameId(settings.publish.arbitration_id, settings.publish.extended)
