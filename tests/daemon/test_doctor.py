"""`ramstroke doctor` as a whole: what it prints, its exit codes, and that it leaves a running daemon alone."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from daemon.cli import main
from daemon.doctor import adis16448, can, daemon_health, disk, examination, jy901, memory
from daemon.doctor import patient as patients
from daemon.doctor.patient import Patient, admit
from daemon.doctor.report import Check, Verdict, fault, not_checked, ok, warning, worst
from daemon.doctor.unit import Unit
from daemon.errors import CommandError
from daemon.service.live import LiveServer
from daemon.settings import Settings
from daemon.simulation.virtual import virtual_line, virtual_support
from drivers.virtual.faults import FaultScript
from drivers.virtual.jy901_port import VirtualSerialPort
from tests.daemon.doctor_kit import LONG_S, NO_SYSTEMD, assert_told_in_sentences, by_name, names_of, patient

PART = {"state": "ok", "since_s": 1.0, "what": "", "advice": ""}
ILL = PART | {"state": "ill", "what": "samples are missed", "advice": "lessen the load"}
WAITING = PART | {"state": "waiting", "what": "there is no network interface can0", "advice": "plug it in"}
HELLO = {"version": "1", "imu": ILL, "jy901": PART | {"state": "off"}, "can": WAITING, "recorder": PART}


def test_a_healthy_patient_is_healthy(tmp_path: Path) -> None:
    who = patient(tmp_path, recording={"budget_mb": 300}, jy901={"use": "beside", "transport": "virtual"})
    who.support = virtual_support(who.settings)
    said: list[str] = []
    who.say = said.append
    checks = examination.examine(who)
    assert names_of(by_name(checks), Verdict.FAULT) == []
    assert_told_in_sentences(checks)
    order = [check.name for check in checks]
    wanted = ["configuration", "program", "daemon", "SPI port", "up axis", "JY901", "displacement", "free space"]
    assert [name for name in order if name in wanted] == wanted
    assert order[-1] == "learned state"
    assert any("listening on" in what for what in said)


def test_a_fault_of_the_program_hides_no_other_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: Patient) -> list[Check]:
        raise ZeroDivisionError("oh")

    who = patient(tmp_path, can={"enabled": False})
    for module in (can, adis16448):
        monkeypatch.setattr(module, "look", broken)
    checks = by_name(examination.examine(who))
    assert checks["CAN"].verdict is Verdict.NOT_CHECKED
    assert "ZeroDivisionError" in checks["CAN"].found
    assert checks["learned state"].verdict is Verdict.OK


def test_the_worst_verdict_is_that_of_the_worst_check() -> None:
    checks = [ok("a", "b"), not_checked("a", "b"), warning("a", "b", "c"), fault("a", "b", "c")]
    assert [worst(checks[: i + 1]) for i in range(4)] == list(Verdict)
    assert worst([]) is Verdict.OK
    assert fault("a", "b", "c", rate_hz=1.0).row() == {
        "name": "a",
        "verdict": "fault",
        "found": "b",
        "advice": "c",
        "rate_hz": 1.0,
    }


# --- the command ----------------------------------------------------------------------------------------------


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """No listening: only what needs no time."""
    for module in (can, adis16448):
        monkeypatch.setattr(module, "look", lambda who: [])
    monkeypatch.setattr(patients, "read_unit", lambda: NO_SYSTEMD)


def configuration(folder: Path, **recording: Any) -> Path:
    path = folder / "x.toml"
    lines = [f'directory = "{folder}/recordings"', "keep_free_mb = 0", "budget_mb = 300"]
    lines += [f"{key} = {json.dumps(value)}" for key, value in recording.items()]
    text = '[imu]\ntransport = "socket"\n[can]\nenabled = false\n[recording]\n' + "\n".join(dict.fromkeys(lines))
    path.write_text(f'{text}\n[service]\nsocket = "{folder}/live"\nstate_file = "{folder}/state.json"\n')
    return path


@pytest.mark.usefixtures("quick")
def test_json_is_one_object_with_a_row_per_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--config", str(configuration(tmp_path)), "--json"]) == 0
    printed = capsys.readouterr()
    report = json.loads(printed.out)
    assert printed.err == ""
    assert report.keys() == {"checks", "worst"}
    assert report["worst"] in ("ok", "not checked", "warning")
    for row in report["checks"]:
        assert row.keys() >= {"name", "verdict", "found", "advice"}
        assert row["advice"]
        assert row["verdict"] in list(Verdict)


@pytest.mark.usefixtures("quick")
def test_a_fault_is_exit_code_1_and_told_with_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(can, "look", lambda who: [fault("CAN interface", "can0 is down [x]", "ip link set can0 up")])
    assert main(["doctor", "--config", str(configuration(tmp_path))]) == 1
    said = capsys.readouterr().out
    assert "can0 is down [x]" in said
    assert "To mend, the first one first:\n  1. CAN interface: ip link set can0 up\n" in said


@pytest.mark.usefixtures("quick")
def test_warnings_are_no_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(memory, "look", lambda who: [warning("learned state", "old", "learn anew")])
    assert main(["doctor", "--config", str(configuration(tmp_path))]) == 0
    assert "Better:\n  1. learned state: learn anew\n" in capsys.readouterr().out


def test_a_bad_configuration_is_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bad.toml"
    path.write_text("[imu]\nspi_port = 1\n")
    assert main(["doctor", "--config", str(path)]) == 2
    assert capsys.readouterr().err.startswith(f"ramstroke: {path}:2: [imu] spi_port is unknown")
    assert main(["doctor", "--config", str(path), "--json"]) == 2
    report = json.loads(capsys.readouterr().out)
    assert report["worst"] == "fault"
    assert report["checks"][0]["name"] == "configuration"
    assert "spi_port is unknown" in report["checks"][0]["found"]


# --- a running daemon -----------------------------------------------------------------------------------------


def beside_daemon(path: Path, scene: Callable[[], None]) -> None:
    async def run() -> None:
        server = LiveServer(path, lambda: HELLO)
        await server.start()
        try:
            await asyncio.wait_for(asyncio.to_thread(scene), 30)
        finally:
            await server.close()

    asyncio.run(run())


def test_the_devices_of_a_running_daemon_are_left_alone(short_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def untouchable(*_: object) -> None:
        pytest.fail("the port was opened")

    monkeypatch.setattr(adis16448, "port_openers", untouchable)
    monkeypatch.setattr(jy901, "serial_opener", untouchable)
    settings = patient(short_path, jy901={"use": "beside", "transport": "virtual"}).settings
    found: dict[str, Check] = {}

    def scene() -> None:
        found.update(by_name(examination.examine(admit(settings, None))))

    beside_daemon(settings.service.socket, scene)
    assert found["daemon"].figures["running"] is True
    assert found["daemon: imu"].verdict is Verdict.WARNING
    assert (found["daemon: can"].verdict, found["daemon: can"].advice) == (Verdict.FAULT, "plug it in")
    assert found["daemon: recorder"].verdict is Verdict.OK
    assert "daemon: jy901" not in found
    assert found["inertial sensor"].verdict is found["JY901"].verdict is Verdict.NOT_CHECKED
    assert found["recording folder"].verdict is not Verdict.NOT_CHECKED
    assert found["live socket"].verdict is Verdict.OK


def test_a_service_on_another_configuration_keeps_the_devices_too(tmp_path: Path) -> None:
    who = patient(tmp_path)
    who.unit = Unit(is_installed=True, state="active", user="root")
    (check,) = daemon_health.look(who)
    assert check.verdict is Verdict.NOT_CHECKED
    assert who.taken
    assert [check.verdict for check in adis16448.look(who)] == [Verdict.NOT_CHECKED]


def test_a_real_port_that_is_missing_is_told_before_anything_is_opened(tmp_path: Path) -> None:
    settings = Settings.model_validate(
        {"imu": {"spi_device": f"{tmp_path}/spidev0.0"}, "service": {"socket": f"{tmp_path}/live"}}
    )
    checks = by_name(adis16448.look(Patient(settings, None, NO_SYSTEMD)))
    assert names_of(checks, Verdict.FAULT) == ["SPI port"]
    assert "dtparam=spi=on" in checks["SPI port"].advice


# --- the JY901 ------------------------------------------------------------------------------------------------


def jy901_checks(folder: Path, *faults: dict[str, Any], **settings: Any) -> dict[str, Check]:
    who = patient(folder, jy901={"use": "instead", "transport": "virtual"} | settings)
    script = FaultScript.model_validate({"fault": [{"at_s": 0.0, "for_s": LONG_S, **one} for one in faults]})
    line = virtual_line(who.settings, virtual_support(who.settings), script)
    checks = jy901.examine(who, lambda: VirtualSerialPort(line, who.clock))
    assert_told_in_sentences(checks)
    return by_name(checks)


def test_a_healthy_jy901_is_healthy(tmp_path: Path) -> None:
    checks = jy901_checks(tmp_path)
    assert names_of(checks, Verdict.FAULT) == names_of(checks, Verdict.WARNING) == []
    assert checks["JY901 rate"].figures["rate_hz"] == pytest.approx(200, rel=0.02)


@pytest.mark.parametrize(
    ("trouble", "name", "verdict"),
    [
        ("serial_cut", "JY901", Verdict.FAULT),
        ("adapter_gone", "serial port", Verdict.FAULT),
        ("jy901_dead_band", "JY901 dead band", Verdict.WARNING),
        ("serial_drops", "JY901 rate", Verdict.WARNING),
    ],
)
def test_what_ails_a_jy901_is_told(trouble: str, name: str, verdict: Verdict, tmp_path: Path) -> None:
    fault_of_it: dict[str, Any] = {"kind": trouble}
    if trouble == "serial_drops":
        fault_of_it |= {"at_s": 1.0, "share": 0.05}
    assert jy901_checks(tmp_path, fault_of_it)[name].verdict is verdict


# --- who may be using the devices ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cause", "is_taken"),
    [
        (FileNotFoundError(2, "No such file or directory"), False),
        (ConnectionRefusedError(111, "Connection refused"), False),
        (PermissionError(13, "Permission denied"), True),
        (TimeoutError("timed out"), True),
        (None, True),
    ],
)
def test_a_daemon_that_cannot_be_asked_may_be_running(
    cause: OSError | None, is_taken: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(path: Path) -> dict[str, Any]:
        raise CommandError("no daemon answers") from cause

    monkeypatch.setattr(patients, "first_line", asked)
    monkeypatch.setattr(patients, "read_unit", lambda: NO_SYSTEMD)
    assert bool(admit(patient(tmp_path).settings, None).taken) is is_taken


def test_a_socket_path_that_is_too_long_is_a_fault(tmp_path: Path) -> None:
    who = patient(tmp_path, service={"socket": f"/tmp/{'x' * 110}"})
    assert by_name(disk.look(who))["live socket"].verdict is Verdict.FAULT
