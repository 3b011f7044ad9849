"""CAN: interface, controller, traffic, displacement. Nothing is sent but by a virtual controller to itself."""

from __future__ import annotations

from collections.abc import Callable

import can

from daemon.doctor import can_link, can_traffic
from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, fault, not_checked, ok
from drivers.can.displacement import build_decoders
from drivers.can.interface import InterfaceFault, open_bus
from drivers.can.link import LinkFacts, read_link
from drivers.can.settings import CanSettings

DISPLACEMENT, REFERENCE = "displacement", "reference"


def look(patient: Patient) -> list[Check]:
    """All checks of the bus."""
    settings = patient.settings.can
    if not settings.enabled:
        return [ok("CAN", "switched off in [can]: the estimate is inertial only")]
    link = read_link(settings.channel) if settings.interface == "socketcan" else None
    checks = _link(settings, link)
    if link is not None and not can_link.can_hear(link):
        why, advice = "nothing can be heard", "mend what stands above first"
        return checks + [not_checked(name, why, advice) for name in (can_traffic.FRAMES, DISPLACEMENT)]
    if settings.interface == "virtual" and patient.status is not None:
        return [*checks, not_checked(can_traffic.FRAMES, "a virtual bus is heard only within the running daemon")]
    if patient.support is None or settings.interface != "virtual":
        return checks + listen(patient, is_wired=link is not None and link.kind != "vcan")
    from daemon.simulation.virtual import ControllerTransmitter, virtual_controller

    sender = ControllerTransmitter(
        patient.settings, virtual_controller(patient.settings, patient.support), patient.clock
    )
    try:
        return checks + listen(patient, sender.send_due)
    finally:
        sender.close()


def listen(patient: Patient, play: Callable[[], None] = lambda: None, *, is_wired: bool = True) -> list[Check]:
    """What comes within some seconds."""
    settings, stroke_mm = patient.settings.can, patient.settings.support.stroke_mm
    patient.say(f"listening on {settings.channel} for {patient.listen_s:g} s")
    observed, reference = build_decoders(settings)
    decoders = [observed] if reference is None else [observed, reference]
    # A daemon that cannot be asked, or a service on another configuration, may be sending or not.
    daemon_sends = True if patient.status is not None else None if patient.taken else False
    ours = can_traffic.own_identifier(settings) if settings.publish.enabled and daemon_sends is not False else None
    try:
        play()  # what a virtual controller had to send until now is gone
        bus = open_bus(settings, None)
        try:
            traffic = can_traffic.listen(bus, patient.clock, patient.listen_s, decoders, play, ours)
        finally:
            bus.shutdown()
    except InterfaceFault as error:
        return [fault(can_traffic.FRAMES, error.what, error.advice)]
    except (can.CanError, OSError, ValueError) as error:
        words = f"{settings.channel} cannot be listened on: {getattr(error, 'strerror', None) or error}"
        return [
            fault(can_traffic.FRAMES, words, "load the kernel's CAN (modprobe can-raw), and check channel in [can]")
        ]
    checks = [
        can_traffic.judge_frames(traffic, settings, is_wired=is_wired),
        can_traffic.judge_displacement(DISPLACEMENT, observed, traffic, stroke_mm),
    ]
    if reference is not None:
        checks.append(can_traffic.judge_displacement(REFERENCE, reference, traffic, stroke_mm, is_reference=True))
    own = can_traffic.judge_own_identifier(traffic, settings, daemon_sends=daemon_sends)
    return checks if own is None else [*checks, own]


def _link(settings: CanSettings, link: LinkFacts | None) -> list[Check]:
    if link is not None:
        return can_link.judge(link, settings)
    if settings.interface == "virtual":
        return [ok(can_link.INTERFACE, f"virtual, {settings.channel}: within this process")]
    return [ok(can_link.INTERFACE, f"UDP multicast {settings.channel}: for trials on one computer")]
