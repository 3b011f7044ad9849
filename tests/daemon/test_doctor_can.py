"""The doctor finds what is wrong with the bus and with the displacement on it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from daemon.doctor import can, can_link, can_traffic
from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, Verdict
from daemon.simulation.virtual import ControllerTransmitter, virtual_controller, virtual_support
from drivers.can.frame import Frame
from drivers.can.interface import to_message
from drivers.can.link import LinkFacts, link_of, read_link
from drivers.can.settings import CanSettings
from drivers.virtual.can_network import NetworkBus, network
from drivers.virtual.faults import FaultScript
from tests.daemon.doctor_kit import LONG_S, assert_told_in_sentences, by_name, names_of, patient


def heard(who: Patient, *faults: dict[str, Any], also: list[Frame] | None = None) -> dict[str, Check]:
    """What the doctor says of a bus on which a controller with these faults sends, and somebody `also`."""
    script = FaultScript.model_validate({"fault": [{"at_s": 0.0, "for_s": LONG_S, **one} for one in faults]})
    support = virtual_support(who.settings)
    sender = ControllerTransmitter(who.settings, virtual_controller(who.settings, support, script), who.clock)
    other = NetworkBus(who.settings.can.channel)
    who.listen_s = 3.0

    def play() -> None:
        sender.send_due()
        for frame in also or ():
            if who.clock.now_ns() // 1_000_000 % 100 == 0:
                other.send(to_message(frame))

    try:
        checks = can.listen(who, play)
    finally:
        sender.close()
        other.shutdown()
    assert_told_in_sentences(checks)
    return by_name(checks)


def test_a_healthy_bus_is_healthy(tmp_path: Path) -> None:
    checks = heard(patient(tmp_path, can={"reference": {"message": "LaboratorySensor", "signal": "reference_stroke"}}))
    assert {check.verdict for check in checks.values()} == {Verdict.OK}
    assert set(checks) == {"CAN frames", "displacement", "reference"}
    assert checks["displacement"].figures["rate_hz"] == pytest.approx(12, abs=4)
    assert set(checks["CAN frames"].figures["identifiers"]) == {"0x310", "0x311"}


@pytest.mark.parametrize(
    ("fault", "found", "advice"),
    [
        ({"kind": "wrong_identifier"}, "no frame 0x310 yet, but 0x311", "to 0x3FF, which has the right length"),
        ({"kind": "wrong_length", "length": 3}, "have 3 bytes instead of 5", "arbitration_id"),
        ({"kind": "corrupted"}, "the checksum of frames 0x310 does not fit", "checksum_signal"),
        ({"kind": "frozen_frame", "at_s": 0.5}, "the message counter stands still", "restart the controller"),
        ({"kind": "sensor_error"}, "the source says", "magnet"),
        ({"kind": "jump", "offset_mm": 2000}, "outside -50 to 1000 mm", "minimum_mm"),
        ({"kind": "can_silence"}, "no frame 0x310 yet", "arbitration_id"),
    ],
    ids=lambda value: value["kind"] if isinstance(value, dict) else "",
)
def test_a_displacement_that_is_wrong_is_told(fault: dict[str, Any], found: str, advice: str, tmp_path: Path) -> None:
    check = heard(patient(tmp_path), fault)["displacement"]
    assert check.verdict is Verdict.FAULT
    assert found in check.found
    assert advice in check.advice


def test_a_value_that_does_not_move_is_no_fault_of_a_resting_ram_and_said(tmp_path: Path) -> None:
    check = heard(patient(tmp_path), {"kind": "stuck_value"})["displacement"]
    assert check.verdict is Verdict.OK
    assert "only a move shows" in check.found
    assert check.figures["least_mm"] == check.figures["largest_mm"]


def test_a_value_beyond_the_stroke_is_a_warning(tmp_path: Path) -> None:
    check = heard(patient(tmp_path), {"kind": "jump", "offset_mm": 700})["displacement"]
    assert check.verdict is Verdict.WARNING
    assert "stroke_mm" in check.advice


def test_a_silent_bus_is_told(tmp_path: Path) -> None:
    who = patient(tmp_path, simulation={"reference": False})
    checks = heard(who, {"kind": "can_silence"})
    assert names_of(checks, Verdict.FAULT) == ["CAN frames"]
    assert checks["displacement"].verdict is Verdict.NOT_CHECKED


def test_error_frames_are_a_warning(tmp_path: Path) -> None:
    check = heard(patient(tmp_path), {"kind": "error_frames"})["CAN frames"]
    assert check.verdict is Verdict.WARNING
    assert "120 ohm" in check.advice


@pytest.mark.parametrize("is_used", [False, True])
def test_our_identifier_must_be_free(is_used: bool, tmp_path: Path) -> None:
    who = patient(tmp_path, can={"listen_only": False, "publish": {"enabled": True}})
    check = heard(who, also=[Frame(0, 0x6F0, bytes(8))] if is_used else [])["estimate identifier"]
    assert check.verdict is (Verdict.FAULT if is_used else Verdict.OK)


def test_beside_our_own_daemon_a_second_sender_is_found() -> None:
    settings = CanSettings.model_validate({"listen_only": False, "publish": {"enabled": True, "period_ms": 100.0}})
    for count, verdict in ((0, Verdict.WARNING), (30, Verdict.OK), (60, Verdict.FAULT)):
        traffic = can_traffic.Traffic(seconds=3.0)
        for _ in range(count):
            traffic.take(Frame(0, 0x6F0, bytes(8)))
        check = can_traffic.judge_own_identifier(traffic, settings, daemon_sends=True)
        assert check is not None
        assert check.verdict is verdict


def test_an_interface_that_is_down_is_told(tmp_path: Path) -> None:
    who = patient(tmp_path)
    network(who.settings.can.channel).is_up = False
    (check,) = can.listen(who)
    assert (check.verdict, check.name) == (Verdict.FAULT, "CAN frames")


def test_no_interface_hides_what_needs_it(tmp_path: Path) -> None:
    who = patient(tmp_path, imu={"transport": "spidev"}, can={"interface": "socketcan", "channel": "can987"})
    checks = by_name(can.look(who))
    assert names_of(checks, Verdict.FAULT) == ["CAN interface"]
    assert "there is no network interface can987" in checks["CAN interface"].found
    assert checks["displacement"].verdict is Verdict.NOT_CHECKED


def test_another_kind_of_interface_is_no_can(tmp_path: Path) -> None:
    who = patient(tmp_path, imu={"transport": "spidev"}, can={"interface": "socketcan", "channel": "lo"})
    checks = by_name(can.look(who))
    assert checks["CAN interface"].found == "lo is no CAN interface"


# What `ip -details -statistics -json link show` prints of a CAN interface, shortened.
SHOWN = """{"ifname":"can0","flags":["NOARP","UP","LOWER_UP","ECHO"],"operstate":"UP","link_type":"can",
"linkinfo":{"info_kind":"can","info_data":{"ctrlmode":["LISTEN-ONLY"],"state":"ERROR-ACTIVE",
"berr_counter":{"tx":0,"rx":3},"restart_ms":100,"bittiming":{"bitrate":250000,"sample_point":"0.875"}},
"info_xstats":{"restarts":0,"bus_error":0,"bus_off":0}},"stats64":{"rx":{"packets":1200,"dropped":0}}}"""


def test_the_words_of_ip_are_understood() -> None:
    link = link_of(json.loads(SHOWN))
    assert link == LinkFacts(
        exists=True,
        is_can=True,
        is_up=True,
        kind="can",
        bitrate=250_000,
        state="error-active",
        transmit_errors=0,
        receive_errors=3,
        restart_ms=100,
        is_listen_only=True,
        restarts=0,
        received=1200,
        dropped=0,
    )
    assert [check.verdict for check in can_link.judge(link, CanSettings())] == [Verdict.OK, Verdict.OK]


@pytest.mark.parametrize(
    ("change", "verdict", "advice"),
    [
        ({"state": "bus-off"}, Verdict.FAULT, "the kernel tries again every 100 ms"),
        ({"state": "bus-off", "restart_ms": 0}, Verdict.FAULT, "then sudo ip link set can0 type can restart;"),
        ({"state": "error-passive"}, Verdict.WARNING, "120 ohm"),
        ({"restart_ms": 0}, Verdict.WARNING, "set can0 down, then sudo ip link set can0 up type can restart-ms 100"),
        ({"dropped": 100}, Verdict.WARNING, "floods"),
        ({"is_listen_only": False}, Verdict.OK, "nothing"),
        ({"state": None}, Verdict.NOT_CHECKED, "nothing"),
    ],
)
def test_the_controller_is_judged(change: dict[str, Any], verdict: Verdict, advice: str) -> None:
    check = can_link.judge_controller(replace(link_of(json.loads(SHOWN)), **change), CanSettings())
    assert check.verdict is verdict
    assert advice in check.advice


def test_listen_only_forbids_what_is_to_be_published() -> None:
    settings = CanSettings.model_validate({"listen_only": False, "publish": {"enabled": True}})
    check = can_link.judge_controller(link_of(json.loads(SHOWN)), settings)
    assert check.verdict is Verdict.FAULT
    assert "listen-only off" in check.advice


def test_an_interface_that_is_down_by_ip_is_a_fault_with_the_command() -> None:
    down = json.loads(SHOWN) | {"flags": ["NOARP", "ECHO"]}
    interface, controller = can_link.judge(link_of(down), CanSettings())
    assert (interface.verdict, controller.verdict) == (Verdict.FAULT, Verdict.NOT_CHECKED)
    assert interface.advice == "sudo ip link set can0 up"
    del down["linkinfo"]["info_data"]["bittiming"]
    (interface, _) = can_link.judge(link_of(down), CanSettings())
    assert interface.advice.startswith("sudo ip link set can0 up type can bitrate 250000 listen-only on restart-ms 100")


def test_a_controller_that_is_bus_off_cannot_be_heard_and_a_listen_only_one_can() -> None:
    link = link_of(json.loads(SHOWN))
    assert can_link.can_hear(link)
    assert not can_link.can_hear(replace(link, state="bus-off"))
    assert not can_link.can_hear(replace(link, is_up=False))


def test_without_ip_the_kernel_s_own_files_tell_what_they_can(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object, **__: object) -> None:
        raise FileNotFoundError(2, "No such file or directory", "ip")

    monkeypatch.setattr("drivers.can.link.subprocess.run", missing)
    link = read_link("lo")
    assert (link.exists, link.is_can, link.is_up, link.bitrate, link.state) == (True, False, True, None, None)
