"""The doctor on disk, clock, rights and service: figures in, verdict out."""

from __future__ import annotations

import grp
import os
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from daemon.doctor import disk, follow_ups, machine, memory, node, program, service
from daemon.doctor.report import Check, Verdict, fault, warning
from daemon.doctor.rights import INSTALL, READ, WRITE, User, groups_to_join, nearest_folder, this_user
from daemon.doctor.unit import Unit, unit_of
from daemon.recording.settings import RecorderSettings
from daemon.service.installer import fitted
from daemon.service.state_file import SavedState, save
from daemon.settings import Settings
from drivers.adis16448.configuration import ImuSettings
from tests.daemon.doctor_kit import NO_SYSTEMD, assert_told_in_sentences, by_name, names_of, patient

MEGA = 1_000_000
NOBODY = User("ramstroke", 54_321, frozenset({54_321}), is_me=False)


# --- disk -----------------------------------------------------------------------------------------------------


def test_a_good_disk_is_good_and_left_as_it_was(tmp_path: Path) -> None:
    who = patient(tmp_path, recording={"budget_mb": 300})
    checks = disk.look(who)
    assert_told_in_sentences(checks)
    assert names_of(by_name(checks), Verdict.FAULT) == []
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_a_fault() -> None:
    check = disk.judge_folder("folder", Path("/proc/ramstroke/recordings"), this_user(), "directory in [recording]")
    assert check.verdict is Verdict.FAULT
    assert "directory in [recording]" in check.advice


def test_the_service_s_user_counts_not_who_asks(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    check = disk.judge_folder("folder", tmp_path / "x", NOBODY, "directory in [recording]")
    assert check.verdict is Verdict.FAULT
    assert "user ramstroke may not write" in check.found
    assert "install -d -o ramstroke" in check.advice


def test_a_file_in_the_place_of_the_folder_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "recordings").write_text("")
    check = disk.judge_folder("folder", tmp_path / "recordings", this_user(), "directory in [recording]")
    assert (check.verdict, check.found) == (Verdict.FAULT, f"{tmp_path}/recordings is no folder")


def test_what_is_lost_at_power_off_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk, "kind_of", lambda *_: "tmpfs")
    check = disk.judge_folder("folder", tmp_path, this_user(), "directory in [recording]")
    assert check.verdict is Verdict.WARNING
    assert "lost when the computer is switched off" in check.found


def test_the_innermost_mount_holds_a_folder() -> None:
    mounts = "overlay / overlay rw 0 0\n/dev/a /var ext4 rw 0 0\ntmpfs /var/lib/my\\040dir tmpfs rw 0 0\n"
    assert disk.kind_of(Path("/var/lib"), mounts) == "ext4"
    assert disk.kind_of(Path("/var/lib/my dir/x"), mounts) == "tmpfs"
    assert disk.kind_of(Path("/variable"), mounts) == "overlay"


@pytest.mark.parametrize(
    ("free_mb", "recorded_mb", "verdict"),
    [
        (10_000, 0, Verdict.OK),
        (1000, 3900, Verdict.OK),
        (1000, 0, Verdict.WARNING),
        (100, 4000, Verdict.WARNING),
        (100, 0, Verdict.FAULT),
    ],
)
def test_free_space_is_judged(free_mb: float, recorded_mb: float, verdict: Verdict) -> None:
    check = disk.judge_space(RecorderSettings(), round(free_mb * MEGA), round(recorded_mb * MEGA))
    assert check.verdict is verdict


def test_a_full_disk_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk, "free_bytes", lambda _: 50 * MEGA)
    checks = by_name(disk.look(patient(tmp_path, recording={"keep_free_mb": 200})))
    assert names_of(checks, Verdict.FAULT) == ["free space"]
    assert "make room" in checks["free space"].advice


@pytest.mark.parametrize(
    ("kb_s", "sync_s", "verdict"),
    [
        (20_000.0, 0.01, Verdict.OK),
        (200.0, 0.1, Verdict.WARNING),
        (20_000.0, 3.0, Verdict.WARNING),
        (40.0, 0.1, Verdict.FAULT),
    ],
)
def test_write_speed_is_judged(kb_s: float, sync_s: float, verdict: Verdict) -> None:
    assert disk.judge_speed(kb_s, sync_s).verdict is verdict


def test_a_probe_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fdatasync", full)
    checks = by_name(disk.look(patient(tmp_path)))
    assert checks["write speed"].verdict is Verdict.NOT_CHECKED
    assert "No space left" in checks["write speed"].found
    assert list(tmp_path.iterdir()) == []


# --- devices --------------------------------------------------------------------------------------------------


def about(path: Path) -> node.Node:
    return node.Node("SPI port", path, "spi_device in [imu]", "switch SPI on", "spidev*")


def test_a_missing_device_is_a_fault(tmp_path: Path) -> None:
    check = node.examine(about(tmp_path / "spidev0.0"), this_user())
    assert check is not None
    assert check.verdict is Verdict.FAULT
    assert check.advice == "switch SPI on, or correct spi_device in [imu]"


def test_a_file_is_no_device(tmp_path: Path) -> None:
    (tmp_path / "spidev0.0").write_text("")
    check = node.examine(about(tmp_path / "spidev0.0"), this_user())
    assert check is not None
    assert "is no device" in check.found


@pytest.fixture
def group_device(tmp_path: Path) -> Path:
    """As udev leaves a port: for the members of a group."""
    device = tmp_path / "spidev0.0"
    device.write_text("")
    os.chown(device, 0, grp.getgrnam("dialout").gr_gid)
    device.chmod(0o660)
    return device


def test_missing_rights_name_the_group(group_device: Path) -> None:
    assert groups_to_join(NOBODY, [group_device]).startswith("sudo usermod -aG dialout ramstroke, then ")


def test_a_device_that_no_group_may_use_is_not_mended_by_a_group() -> None:
    check = node.examine(about(Path("/dev/kmsg")), NOBODY)
    assert check is not None
    assert check.verdict is Verdict.FAULT
    assert check.advice.startswith(INSTALL)


def test_a_device_that_is_well_needs_no_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node, "holders", lambda _: [])
    assert node.examine(about(Path("/dev/null")), NOBODY) is None


def test_a_program_that_holds_the_device_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node, "holders", lambda _: ["python (process 77)"])
    check = node.examine(about(Path("/dev/null")), this_user())
    assert check is not None
    assert check.found == "/dev/null is in use by python (process 77)"


def test_rights_are_those_of_the_mode(tmp_path: Path) -> None:
    file = tmp_path / "x"
    file.write_text("")
    file.chmod(0o640)
    gid = file.stat().st_gid
    assert not NOBODY.may(file, READ)
    member = User("member", 54_322, frozenset({gid}), is_me=False)
    assert member.may(file, READ)
    assert not member.may(file, WRITE)
    assert nearest_folder(tmp_path / "a" / "b") == tmp_path


# --- the computer ---------------------------------------------------------------------------------------------


def test_the_clock_is_judged() -> None:
    now = datetime(2026, 5, 1, tzinfo=UTC)
    assert machine.judge_clock(now, 1e-9).verdict is Verdict.OK
    assert machine.judge_clock(now.replace(year=1970), 1e-9).verdict is Verdict.WARNING
    assert machine.judge_clock(now, 4e-3).verdict is Verdict.WARNING
    said = {True: Verdict.OK, False: Verdict.WARNING, None: Verdict.NOT_CHECKED}
    assert {is_so: machine.judge_synchronised(is_so).verdict for is_so in said} == said


def test_a_refused_priority_is_a_warning() -> None:
    assert machine.judge_real_time(None, 0, False, "the service").verdict is Verdict.OK
    assert machine.judge_real_time(50, 50, False, "the service").verdict is Verdict.OK
    assert machine.judge_real_time(50, 0, True, "who asks").verdict is Verdict.OK
    check = machine.judge_real_time(60, 50, False, "the service")
    assert check.verdict is Verdict.WARNING
    assert "LimitRTPRIO=60" in check.advice


def test_processors_and_supply_are_judged() -> None:
    process = ImuSettings(acquisition="process")
    assert machine.judge_processors(process, 1, set()).verdict is Verdict.WARNING
    assert machine.judge_processors(process, 4, {"ondemand"}).verdict is Verdict.OK
    assert machine.judge_processors(ImuSettings(), 4, {"powersave"}).verdict is Verdict.WARNING
    assert machine.judge_supply(0).verdict is Verdict.OK
    assert machine.judge_supply(None).verdict is Verdict.NOT_CHECKED
    assert "supply" in machine.judge_supply(1 << 16).advice
    assert "cool" in machine.judge_supply(1 << 2).advice


def test_missing_modules_are_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = Settings.model_validate({"imu": {"data_ready_line": 25}, "jy901": {"use": "beside"}})
    assert program.needed_modules(settings) == ["spidev", "gpiod", "serial"]
    monkeypatch.setattr(program, "needed_modules", lambda _: ["ramstroke_nowhere"])
    check = program.judge_modules(settings)
    assert check.verdict is Verdict.FAULT
    assert "`systemd/install.sh WHEEL`" in check.advice


# --- the service ----------------------------------------------------------------------------------------------

SHOWN = """\
LoadState=loaded
ActiveState=active
SubState=running
UnitFileState=enabled
Result=success
MainPID=812
NRestarts=0
WatchdogUSec=10s
ExecStart={ path=/opt/r ; argv[]=/opt/r/ramstroke run --config /etc/ramstroke/ramstroke.toml ; ignore_errors=no }
User=root
LimitRTPRIO=50
RuntimeDirectory=ramstroke
"""
CONFIGURATION = Path("/etc/ramstroke/ramstroke.toml")


def test_the_words_of_systemctl_are_understood() -> None:
    unit = unit_of(SHOWN)
    assert (unit.configuration, unit.user, unit.realtime_limit, unit.main_pid) == (CONFIGURATION, "root", 50, 812)
    assert unit.has_watchdog
    assert unit.is_active
    assert unit_of("LoadState=not-found\nActiveState=inactive\n") == Unit(is_installed=False)


@pytest.mark.parametrize(
    ("change", "verdict", "advice"),
    [
        ("", Verdict.OK, "nothing"),
        ("ActiveState=failed\nResult=exit-code", Verdict.FAULT, "journalctl"),
        ("UnitFileState=disabled", Verdict.WARNING, "systemctl enable"),
        ("ActiveState=inactive", Verdict.WARNING, "systemctl start"),
        ("WatchdogUSec=0", Verdict.WARNING, "WatchdogSec=10"),
        ("NRestarts=7", Verdict.WARNING, "journalctl"),
    ],
)
def test_the_unit_is_judged(change: str, verdict: Verdict, advice: str) -> None:
    check = service.judge_unit(unit_of(SHOWN + change))
    assert check.verdict is verdict
    assert advice in check.advice


def test_another_configuration_than_the_service_s_is_a_warning(tmp_path: Path) -> None:
    assert service.judge_configuration(unit_of(SHOWN), CONFIGURATION).verdict is Verdict.OK
    assert service.judge_configuration(unit_of(SHOWN), None).verdict is Verdict.WARNING
    check = service.judge_configuration(unit_of(SHOWN), tmp_path / "x.toml")
    assert check.verdict is Verdict.WARNING
    assert str(CONFIGURATION) in check.advice


def test_a_user_that_does_not_exist_is_a_fault() -> None:
    check = service.judge_rights(unit_of(SHOWN.replace("User=root", "User=no-such-user")), Settings())
    assert check.verdict is Verdict.FAULT
    assert check.advice.startswith(INSTALL)


def test_the_service_s_user_needs_the_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = tmp_path / "spidev0.0"
    device.write_text("")
    device.chmod(0o600)
    monkeypatch.setattr(service, "named_user", lambda _: NOBODY)
    settings = Settings.model_validate({"imu": {"spi_device": str(device)}})
    check = service.judge_rights(unit_of(SHOWN), settings)
    assert check.verdict is Verdict.FAULT
    assert check.figures["refused"] == [str(device)]


def looked_at_service(folder: Path, unit: Unit | str) -> list[Check]:
    who = patient(folder)
    who.unit = unit
    return service.look(who)


def test_without_systemd_or_unit_that_is_said(tmp_path: Path) -> None:
    (check,) = looked_at_service(tmp_path, NO_SYSTEMD)
    assert (check.verdict, check.found) == (Verdict.NOT_CHECKED, NO_SYSTEMD)
    (check,) = looked_at_service(tmp_path, Unit(is_installed=False))
    assert check.verdict is Verdict.WARNING
    assert len(looked_at_service(tmp_path, unit_of(SHOWN))) == 4


def test_a_unit_of_another_version_is_told(tmp_path: Path) -> None:
    file = tmp_path / "ramstroke.service"
    file.write_text(fitted("ramstroke.service"))
    unit = replace(unit_of(SHOWN), file=file)
    assert service.judge_file(unit).verdict is Verdict.OK
    file.write_text(file.read_text().replace("WatchdogSec=10", "WatchdogSec=0"))
    assert service.judge_file(unit).verdict is Verdict.WARNING
    assert service.judge_file(replace(unit, file=tmp_path / "gone")).verdict is Verdict.NOT_CHECKED


@pytest.mark.parametrize(
    ("lines", "writable"),
    [
        ("", None),
        ("ProtectSystem=full\nStateDirectory=ramstroke", None),
        (
            "ProtectSystem=strict\nStateDirectory=ramstroke\nReadWritePaths=-/mnt/a /b",
            ["/mnt/a", "/b", "/var/lib/ramstroke", "/run/ramstroke"],
        ),
    ],
)
def test_folders_that_the_sandbox_leaves_open(lines: str, writable: list[str] | None) -> None:
    found = unit_of(SHOWN + lines).writable
    assert (found and [str(path) for path in found]) == writable


def test_a_folder_outside_the_sandbox_is_a_fault_though_its_user_may_write(tmp_path: Path) -> None:
    inside, outside = tmp_path / "a", tmp_path / "ab"
    inside.mkdir()
    outside.mkdir()
    judged = [disk.judge_folder("x", one, this_user(), "directory", [inside]) for one in (inside / "deep", outside)]
    assert [check.verdict for check in judged] == [Verdict.OK, Verdict.FAULT]
    assert f"ReadWritePaths={outside}" in judged[1].advice


# --- what follows from what -----------------------------------------------------------------------------------


def test_what_follows_from_a_fault_is_nothing_to_mend_of_its_own() -> None:
    checks = [
        fault("CAN interface", "vcan0 is down", "set it up"),
        fault("daemon: can", "vcan0 is down", "wait"),
        warning("daemon: displacement", "silent", "see"),
        fault("daemon: imu", "waiting", "plug it in"),
        warning("daemon: estimator", "no estimate", "see"),
        warning("clock", "no time server", "see"),
        fault("service's rights", "may not", "join"),
        fault("SPI port", "may not", "join"),
    ]
    roots = [check.follows_from for check in follow_ups.marked(checks)]
    assert roots == ["", "CAN interface", "CAN interface", "", "CAN interface", "", "", "service's rights"]
    assert [check.follows_from for check in follow_ups.marked(checks[2:3] + checks[4:6])] == ["", "", ""]


# --- the learned state ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "verdict", "found"),
    [
        (None, Verdict.OK, "nothing is learned"),
        ({"stroke_mm": 500.0}, Verdict.OK, "of this machine"),
        ({"stroke_mm": 800.0}, Verdict.WARNING, "of another machine"),
        ({"stroke_mm": 500.0, "wall_time_s": 9e9}, Verdict.WARNING, "later than now"),
    ],
)
def test_the_state_file_is_judged(content: dict[str, Any] | None, verdict: Verdict, found: str, tmp_path: Path) -> None:
    who = patient(tmp_path)
    if content is not None:
        state = {"wall_time_s": 1e9, "displacement_mm": 12.0, "sigma_mm": 1.0, "at_rest": True} | content
        save(who.settings.service.state_file, SavedState(**state))
    (check,) = memory.look(who)
    assert check.verdict is verdict
    assert found in check.found
