"""`install-service` and `remove-service` into a folder that stands for a computer."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from daemon.cli import main
from daemon.errors import CommandError
from daemon.service import installer
from daemon.service.installer import (
    CONFIGURATION,
    DROP_INS,
    FILES,
    REALTIME,
    STATE,
    TRIAL,
    TRIAL_CONFIGURATION,
    UNITS,
    configuration_in_use,
    shipped,
)


def install(root: Path, *more: str) -> int:
    return main(["install-service", "--root", str(root), *more])


def test_everything_is_put_there_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert install(tmp_path) == 0
    said = capsys.readouterr().out + capsys.readouterr().err
    for path in (*FILES.values(), CONFIGURATION):
        assert (tmp_path / path).is_file()
        assert f"wrote /{path}" in said
    assert (tmp_path / "usr/local/bin/ramstroke").is_symlink()
    assert not (tmp_path / REALTIME).exists()
    assert install(tmp_path) == 0
    assert "wrote" not in capsys.readouterr().out  # nothing was of another version


def test_units_name_the_program_where_it_is(tmp_path: Path) -> None:
    assert install(tmp_path) == 0
    text = (tmp_path / FILES["ramstroke.service"]).read_text()
    assert f"ExecStart={sys.prefix}/bin/ramstroke run --config /etc/ramstroke/ramstroke.toml" in text


def test_an_upgrade_mends_the_unit_and_keeps_what_people_wrote(tmp_path: Path) -> None:
    assert install(tmp_path, "--realtime") == 0
    unit, config = tmp_path / FILES["ramstroke.service"], tmp_path / CONFIGURATION
    unit.write_text("[Unit]\nDescription=of an older version\n")
    config.write_text("[support]\nstroke_mm = 900\n")
    recording = tmp_path / STATE / "recordings" / "one.mcap"
    recording.parent.mkdir(parents=True)
    recording.write_bytes(b"precious")
    assert install(tmp_path) == 0
    assert "of an older version" not in unit.read_text()
    assert config.read_text() == "[support]\nstroke_mm = 900\n"
    assert recording.read_bytes() == b"precious"
    assert (tmp_path / REALTIME).is_file()


def test_removal_keeps_what_cannot_be_made_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert install(tmp_path, "--realtime") == 0
    recording = tmp_path / STATE / "one.mcap"
    recording.parent.mkdir(parents=True)
    recording.write_bytes(b"precious")
    assert main(["remove-service", "--root", str(tmp_path)]) == 0
    assert "kept /var/lib/ramstroke" in capsys.readouterr().out
    left = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if not path.is_dir())
    assert left == ["etc/ramstroke/ramstroke.toml", "var/lib/ramstroke/one.mcap"]
    assert main(["remove-service", "--root", str(tmp_path), "--purge"]) == 0
    assert [path for path in tmp_path.rglob("*") if not path.is_dir()] == []


def test_a_program_of_that_name_that_is_not_ours_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "usr/local/bin/ramstroke"
    other.parent.mkdir(parents=True)
    other.write_text("#!/bin/sh\n")
    assert install(tmp_path) == 0
    assert "is another program and stays" in capsys.readouterr().out
    assert other.read_text() == "#!/bin/sh\n"


def test_a_bad_configuration_is_not_started(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / CONFIGURATION
    config.parent.mkdir(parents=True)
    config.write_text("[imu]\nspi_port = 1\n")
    assert install(tmp_path, "--start") == 2
    assert "spi_port is unknown" in capsys.readouterr().err
    config.write_text("")
    assert install(tmp_path, "--start") == 0


def test_a_trial_has_its_own_configuration_outlasts_an_upgrade_and_is_ended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    host = installer.Host(tmp_path, print)
    assert install(tmp_path, "--trial") == 0
    assert "until: sudo ramstroke install-service --no-trial" in capsys.readouterr().out
    drop_in = (tmp_path / TRIAL).read_text()
    assert f"ExecStart={sys.prefix}/bin/ramstroke run --config /{TRIAL_CONFIGURATION}" in drop_in
    of_page = tmp_path / UNITS / "ramstroke-view.service.d"
    assert f"ramstroke view --config /{TRIAL_CONFIGURATION}" in (of_page / "trial.conf").read_text()
    assert configuration_in_use(host) == TRIAL_CONFIGURATION
    real, own = tmp_path / CONFIGURATION, "[simulation]\nseed = 3\n"
    before = real.read_text()
    (tmp_path / TRIAL_CONFIGURATION).write_text(own)
    (tmp_path / TRIAL).write_text("[Unit]\n# of an older version\n")
    assert install(tmp_path) == 0
    assert "until: sudo ramstroke install-service --no-trial" in capsys.readouterr().out
    assert (tmp_path / TRIAL).read_text() == drop_in
    assert install(tmp_path, "--no-trial") == 0
    assert "on trial" not in capsys.readouterr().out
    assert not (tmp_path / DROP_INS).exists()
    assert not of_page.exists()
    assert configuration_in_use(host) == CONFIGURATION
    assert real.read_text() == before
    assert (tmp_path / TRIAL_CONFIGURATION).read_text() == own


def test_a_trial_is_not_started_with_a_bad_configuration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / TRIAL_CONFIGURATION
    config.parent.mkdir(parents=True)
    config.write_text("[imu]\nspi_port = 1\n")
    assert install(tmp_path, "--trial", "--start") == 2
    assert "trial.toml" in capsys.readouterr().err
    assert install(tmp_path, "--no-trial", "--start") == 0


def test_what_people_wrote_for_the_unit_stays_without_purge(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert install(tmp_path, "--realtime", "--trial") == 0
    folders = DROP_INS, UNITS / "ramstroke-view.service.d"
    for folder in folders:
        (tmp_path / folder / "override.conf").write_text("[Service]\nReadWritePaths=/mnt/recordings\n")
    assert main(["remove-service", "--root", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    for folder in folders:
        assert f"kept /{folder}" in said
        assert [path.name for path in (tmp_path / folder).iterdir()] == ["override.conf"]
    assert main(["remove-service", "--root", str(tmp_path), "--purge"]) == 0
    for folder in folders:
        assert not (tmp_path / folder).exists()


def test_an_upgrade_restarts_what_runs_the_page_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[tuple[str, ...]] = []
    monkeypatch.setattr(installer.Host, "run", lambda _, *command: ran.append(command))
    assert install(tmp_path) == 0
    assert ran[-1] == ("systemctl", "try-restart", "ramstroke.service", "ramstroke-view.service")


@pytest.mark.parametrize("command", ["install-service", "remove-service"])
def test_what_cannot_be_written_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert install(tmp_path) == 0
    (tmp_path / FILES["ramstroke.service"]).write_text("old")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "write_text", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)
    capsys.readouterr()
    assert main([command, "--root", str(tmp_path)]) == 1
    said = capsys.readouterr().err
    assert "run it as root, with sudo" in said
    assert said.count("\n") == 1


def test_a_command_that_fails_or_is_missing_is_one_sentence() -> None:
    host = installer.Host(Path("/"), print)
    with pytest.raises(CommandError, match="is missing: install-service is for a Linux with systemd"):
        host.run("no-such-command-here")
    with pytest.raises(CommandError, match="`ls /no/such/folder` failed: ls: cannot access"):
        host.run("ls", "/no/such/folder")


SANDBOX = {
    "DevicePolicy": "closed",
    "IPAddressDeny": "any",
    "ProtectSystem": "strict",
    "CapabilityBoundingSet": "",
    "RestrictAddressFamilies": "AF_CAN AF_UNIX",
    "SystemCallErrorNumber": "EPERM",
    "SystemCallArchitectures": "native",
    "ProtectProc": "invisible",
    "ProcSubset": "pid",
} | dict.fromkeys(
    (
        *("NoNewPrivileges", "ProtectHome", "PrivateTmp", "PrivateMounts", "ProtectClock", "ProtectHostname"),
        *("ProtectKernelTunables", "ProtectKernelModules", "ProtectKernelLogs", "ProtectControlGroups"),
        *("LockPersonality", "MemoryDenyWriteExecute", "RestrictRealtime", "RestrictSUIDSGID", "RestrictNamespaces"),
    ),
    "yes",
)


@pytest.mark.parametrize("name", ["ramstroke.service", "ramstroke-sim.service"])
def test_the_sandbox_is_as_tight_as_promised(name: str, tmp_path: Path) -> None:
    """Its options; and 1.5 at most by systemd's own measure where there is one to ask (`make acceptance` has it)."""
    options = dict(line.split("=", 1) for line in shipped(name).splitlines() if "=" in line and line[0] != "#")
    assert {key: options.get(key) for key in SANDBOX} == SANDBOX
    analyze = shutil.which("systemd-analyze")
    if analyze is not None:
        unit = tmp_path / name
        unit.write_text(shipped(name))
        command = [analyze, "security", "--offline=yes", "--threshold=15", str(unit)]
        done = subprocess.run(command, capture_output=True, check=False)
        assert done.returncode == 0, done.stdout.decode()[-300:]


def test_the_wheel_carries_the_units() -> None:
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    assert '"systemd" = "daemon/systemd"' in text
    for name in (*FILES, "ramstroke-realtime.conf", "ramstroke-trial.conf"):
        assert shipped(name)
