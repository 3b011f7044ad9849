"""The CAN interface and its controller: there, up, at which bit rate, in which state, and may it send."""

from __future__ import annotations

from collections.abc import Sequence

from daemon.doctor.report import Check, fault, not_checked, ok, warning
from drivers.can.error_frames import BUS_OFF
from drivers.can.link import LinkFacts, can_interfaces
from drivers.can.settings import CanSettings

INTERFACE, CONTROLLER = "CAN interface", "CAN controller"
_CABLE = "check CANH, CANL, the 120 ohm resistors at both ends and the bit rate"
_DROPPED_SHARE = 0.01


def judge(link: LinkFacts, settings: CanSettings) -> list[Check]:
    """Both checks of a kernel interface."""
    return [judge_interface(link, settings, can_interfaces()), judge_controller(link, settings)]


def can_hear(link: LinkFacts) -> bool:
    """Whether frames may come."""
    return link.exists and link.is_can and link.is_up and link.state != BUS_OFF


def judge_interface(link: LinkFacts, settings: CanSettings, others: Sequence[str] = ()) -> Check:
    """Is it there, CAN, and up; `others`: the CAN interfaces that are there."""
    name = settings.channel
    if not link.exists:
        appear = "plug the adapter in and load its driver (dmesg tells)"
        if name.startswith("vcan"):
            appear = f"sudo ip link add dev {name} type vcan, then sudo ip link set {name} up"
        if others:
            advice = f"correct channel in [can], or {appear}"
            return fault(INTERFACE, f"there is no network interface {name}, but {', '.join(others)}", advice)
        return fault(INTERFACE, f"there is no network interface {name}", f"{appear}, or correct channel in [can]")
    if not link.is_can:
        return fault(INTERFACE, f"{name} is no CAN interface", "name a CAN interface as channel in [can]: ip -br link")
    if not link.is_up:
        set_up = f"sudo ip link set {name} up"
        if link.kind == "vcan" or link.bitrate:
            return fault(INTERFACE, f"{name} is down", set_up)
        silent = "" if settings.publish.enabled else " listen-only on"
        advice = f"{set_up} type can bitrate 250000{silent} restart-ms 100 with the bit rate of your bus"
        return fault(INTERFACE, f"{name} is down, and no bit rate is known", advice)
    figures = {"bitrate": link.bitrate, "kind": link.kind}
    if link.bitrate:
        return ok(INTERFACE, f"{name} is up, {link.bitrate:,} bit/s", **figures)
    return ok(INTERFACE, f"{name} is up{', virtual' if link.kind == 'vcan' else ''}, bit rate not known", **figures)


def judge_controller(link: LinkFacts, settings: CanSettings) -> Check:
    """State, error counters, recovery, and listen-only against what is to be sent."""
    name = settings.channel
    if not (link.exists and link.is_can and link.is_up):
        return not_checked(CONTROLLER, f"{name} is not up", "mend what stands above first")
    if link.state is None:
        return not_checked(CONTROLLER, f"nothing tells the state of {name}: it is virtual, or iproute2 is missing")
    figures = {
        "state": link.state,
        "transmit_errors": link.transmit_errors,
        "receive_errors": link.receive_errors,
        "restart_ms": link.restart_ms,
        "listen_only": link.is_listen_only,
        "restarts": link.restarts,
        "dropped": link.dropped,
    }
    counted = f"error counters transmit {link.transmit_errors}, receive {link.receive_errors}"
    found = f"{link.state}, {counted}, restart-ms {link.restart_ms}, {'' if link.is_listen_only else 'not '}listen-only"
    # The kernel refuses another restart-ms while the interface is up.
    restarting = f"sudo ip link set {name} down, then sudo ip link set {name} up type can restart-ms 100"
    if link.state == BUS_OFF:
        then = f"the kernel tries again every {link.restart_ms} ms"
        if not link.restart_ms:
            then = f"then sudo ip link set {name} type can restart; so that it comes back by itself: {restarting}"
        advice = f"look for a short circuit of CANH and CANL or a wrong bit rate; {then}"
        return fault(CONTROLLER, found, advice, **figures)
    if settings.publish.enabled and link.is_listen_only:
        advice = (
            f"sudo ip link set {name} down, then sudo ip link set {name} up type can listen-only off; or "
            "enabled = false in [can.publish]"
        )
        return fault(CONTROLLER, f"the estimate is to be sent, but {name} is listen-only", advice, **figures)
    if link.state not in ("error-active", "stopped", "sleeping"):
        return warning(CONTROLLER, found, _CABLE, **figures)
    if link.dropped and link.received and link.dropped > _DROPPED_SHARE * link.received:
        return warning(CONTROLLER, f"{found}; {link.dropped} frames dropped", "see what floods the bus", **figures)
    if not link.restart_ms:
        return warning(CONTROLLER, f"{found}: after bus-off it stays off", restarting, **figures)
    if not settings.publish.enabled and not link.is_listen_only:
        return ok(CONTROLLER, f"{found}: it acknowledges frames; set listen-only on a bus that is not yours", **figures)
    return ok(CONTROLLER, found, **figures)
