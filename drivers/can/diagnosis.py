"""What is wrong with a CAN link, from what was seen of it: the worst thing first, and what to do about it."""

from __future__ import annotations

import errno
from dataclasses import dataclass

from drivers.can.error_frames import BUS_OFF, ERROR_ACTIVE, ERROR_PASSIVE, ERROR_WARNING
from drivers.condition import OK, Condition, Wellness

MANY_ERROR_FRAMES = 10  # in one second; a good bus has none

_SHORT = "look for a short circuit of CANH and CANL or a wrong bit rate"
_CABLE = "check CANH, CANL, the 120 ohm resistors at both ends and the bit rate"
_ALONE = (
    "this computer may be alone on the bus, or beside listen-only partners: "
    "check that the controller is switched on, CANH, CANL, termination and the bit rate"
)
_BY_ERRNO = {
    errno.ENETDOWN: "ip link set {} up",
    errno.ENODEV: "plug it in or create it again",
    errno.ENXIO: "plug it in or create it again",
    errno.EACCES: "give the service the right to open CAN sockets",
    errno.EPERM: "give the service the right to open CAN sockets",
    errno.EAFNOSUPPORT: "let the kernel and the service have CAN: modprobe can-raw, RestrictAddressFamilies=AF_CAN",
}


@dataclass(slots=True, frozen=True)
class Failure:
    """Why a bus cannot be used now."""

    what: str
    advice: str


@dataclass(slots=True, frozen=True)
class LinkFacts:
    """What is known of a link at one moment."""

    channel: str
    failure: Failure | None = None  # set while there is no open bus
    controller_state: str = ERROR_ACTIVE
    transmit_errors: int | None = None
    receive_errors: int | None = None
    bus_offs: int = 0  # lately, also those that the kernel has ended
    nobody_acknowledges: bool = False
    error_frames: int = 0  # in the last second
    last_error: str = ""
    # None while a data frame, a wanted one, came in time; else for how long there was none
    silent_s: float | None = None
    unwanted_only_s: float | None = None
    wanted: str = ""  # identifiers
    strangers: str = ""  # some identifiers that came, but that nobody wants; empty if the kernel filters them
    overload: int = 0  # wanted frames in excess lately
    kernel_drops: int = 0  # frames lost lately
    send_error: str = ""  # why the last frame could not be sent
    never_sent: int = 0  # frames that the interface took and dropped lately


def failure_of(what: str, channel: str, number: int | None) -> Failure:
    """A failure of the bus with the advice that fits its errno."""
    advice = _BY_ERRNO.get(number or 0, "nothing: it is tried again by itself; if it stays, check adapter and driver")
    return Failure(what, advice.format(channel))


def diagnose(facts: LinkFacts) -> Condition:
    """The worst of what ails a link."""
    found = _no_link(facts) or _bus_ill(facts) or _nothing_comes(facts) or _what_was(facts)
    return found or OK


def _no_link(facts: LinkFacts) -> Condition | None:
    if facts.failure is not None:
        return Condition(Wellness.WAITING, facts.failure.what, facts.failure.advice)
    if facts.controller_state == BUS_OFF:
        return Condition(
            Wellness.WAITING,
            f"{facts.channel} is bus-off: too many errors while sending",
            f"{_SHORT}, then ip link set {facts.channel} type can restart; "
            "with restart-ms 100, set while the interface is down, it comes back by itself",
        )
    return None


def _bus_ill(facts: LinkFacts) -> Condition | None:
    if facts.nobody_acknowledges:
        return Condition(Wellness.ILL, f"no acknowledgement on {facts.channel}: no other node confirms a frame", _ALONE)
    counted = ""
    if facts.transmit_errors is not None:
        counted = f" (error counters: transmit {facts.transmit_errors}, receive {facts.receive_errors})"
    if facts.controller_state == ERROR_PASSIVE:
        return Condition(Wellness.ILL, f"{facts.channel} is error-passive: close to bus-off{counted}", _CABLE)
    if facts.error_frames >= MANY_ERROR_FRAMES:
        what = f"{facts.error_frames} error frames on {facts.channel} in the last second, the last: {facts.last_error}"
        return Condition(Wellness.ILL, what, _CABLE)
    if facts.controller_state == ERROR_WARNING:
        return Condition(Wellness.ILL, f"{facts.channel} is in error-warning: many errors{counted}", _CABLE)
    return None


def _nothing_comes(facts: LinkFacts) -> Condition | None:
    if facts.unwanted_only_s is not None:
        advice = f"identifiers seen: {facts.strangers}" if facts.strangers else f"candump {facts.channel} shows them"
        return Condition(
            Wellness.WAITING,
            f"frames arrive on {facts.channel}, but none with the wanted identifier {facts.wanted} "
            f"for {facts.unwanted_only_s:.0f} s",
            f"{advice}; correct `preset`, `arbitration_id` or `node_id`, or let the controller send it",
        )
    if facts.silent_s is not None:
        return Condition(
            Wellness.WAITING,
            f"no frame at all for {facts.silent_s:.0f} s although {facts.channel} is up",
            "check CANH/CANL wiring, bit rate and that the controller is switched on",
        )
    return None


def _what_was(facts: LinkFacts) -> Condition | None:
    if facts.bus_offs:
        times = "once" if facts.bus_offs == 1 else f"{facts.bus_offs} times"
        what = f"{facts.channel} went bus-off {times} in the last 10 s, and came back"
        return Condition(Wellness.ILL, what, _SHORT)
    if facts.overload:
        return Condition(
            Wellness.ILL,
            f"too many wanted frames on {facts.channel}: {facts.overload} in excess were not used in the last 10 s",
            f"find the node that floods the bus: candump {facts.channel}",
        )
    if facts.kernel_drops:
        return Condition(
            Wellness.ILL,
            f"{facts.kernel_drops} frames of {facts.channel} were lost in the last 10 s: its receive buffer was full",
            "see what else the computer does, and what floods the bus",
        )
    if facts.send_error:
        return Condition(Wellness.ILL, f"sending on {facts.channel} fails: {facts.send_error}", _ALONE)
    if facts.never_sent:
        name = facts.channel
        return Condition(
            Wellness.ILL,
            f"{name} dropped {facts.never_sent} frames that were to be sent in the last 10 s: is it listen-only?",
            f"ip link set {name} down, then ip link set {name} up type can listen-only off; "
            "or `enabled = false` in [can.publish]",
        )
    return None
