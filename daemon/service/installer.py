"""The service on this computer: unit, user, device rights, configuration; put there, brought up to date, taken away."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from daemon.configuration import load
from daemon.errors import CommandError

SHIPPED_PREFIX = "/opt/ramstroke"  # in the units as they come
UNITS = Path("etc/systemd/system")
CONFIGURATION = Path("etc/ramstroke/ramstroke.toml")
TRIAL_CONFIGURATION = Path("etc/ramstroke/trial.toml")
COMMAND = Path("usr/local/bin/ramstroke")
STATE = Path("var/lib/ramstroke")
# Shipped file -> where it goes.
FILES = {
    "ramstroke.service": UNITS / "ramstroke.service",
    "ramstroke-sim.service": UNITS / "ramstroke-sim.service",
    "ramstroke-view.service": UNITS / "ramstroke-view.service",
    "60-ramstroke.rules": Path("etc/udev/rules.d/60-ramstroke.rules"),
    "ramstroke.sysusers.conf": Path("etc/sysusers.d/ramstroke.conf"),
    "ramstroke.tmpfiles.conf": Path("etc/tmpfiles.d/ramstroke.conf"),
}
DROP_INS = UNITS / "ramstroke.service.d"
REALTIME = DROP_INS / "realtime.conf"
TRIAL = DROP_INS / "trial.conf"
TRIALS = {TRIAL: "ramstroke-trial.conf", UNITS / "ramstroke-view.service.d" / "trial.conf": "ramstroke-view-trial.conf"}
_MADE = (
    ("systemd-sysusers", "/etc/sysusers.d/ramstroke.conf"),
    ("systemd-tmpfiles", "--create", "/etc/tmpfiles.d/ramstroke.conf"),
    ("udevadm", "control", "--reload"),
    ("udevadm", "trigger", "--subsystem-match=spidev", "--subsystem-match=gpio"),
    ("systemctl", "daemon-reload"),
)


@dataclass(frozen=True)
class Host:
    """The computer, or a folder that stands for it: then nothing is run.

    say: told each thing that is done.
    """

    root: Path
    say: Callable[[str], object]

    @property
    def is_real(self) -> bool:
        """Whether it is this computer."""
        return self.root == Path("/")

    def run(self, *command: str) -> None:
        """Raises CommandError if the command is missing or fails."""
        if not self.is_real:
            return
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except FileNotFoundError as error:
            raise CommandError(f"{command[0]} is missing: install-service is for a Linux with systemd") from error
        if done.returncode:
            raise CommandError(f"`{' '.join(command)}` failed: {done.stderr.strip() or done.stdout.strip()}")

    def write(self, path: Path, text: str) -> None:
        """Put the text there, unless it stands there already. Raises CommandError."""
        target = self.root / path
        try:
            if target.exists() and target.read_text(encoding="utf-8") == text:
                return
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(text, encoding="utf-8")
        except OSError as error:
            raise CommandError(f"cannot write {target} ({error.strerror}): run it as root, with sudo") from error
        self.say(f"wrote /{path}")

    def has(self, path: Path) -> bool:
        """Whether there is such a file or folder."""
        return (self.root / path).exists()

    def delete(self, path: Path) -> None:
        """Take a file or folder away, if it is there. Raises CommandError."""
        target = self.root / path
        try:
            if target.is_dir() and not target.is_symlink():
                shutil.rmtree(target)
            elif target.is_symlink() or target.exists():
                target.unlink()
            else:
                return
        except OSError as error:
            raise CommandError(f"cannot delete {target} ({error.strerror}): run it as root, with sudo") from error
        self.say(f"deleted /{path}")


def install(host: Host, *, realtime: bool, trial: bool | None) -> None:
    """Write what is missing or of another version; a configuration that is there stays. Raises CommandError.

    Args:
        host: where.
        realtime: allow a real-time priority from now on.
        trial: let the service work with the virtual support, or with the real one again; None leaves it as it is.
    """
    for name, path in FILES.items():
        host.write(path, fitted(name))
    if realtime:
        host.write(REALTIME, shipped("ramstroke-realtime.conf"))
    if trial or (trial is None and host.has(TRIAL)):
        for path, name in TRIALS.items():
            host.write(path, fitted(name))
        _write_configuration(host, TRIAL_CONFIGURATION, "trial_service.toml")
    elif host.has(TRIAL):
        for path in TRIALS:
            host.delete(path)
            _delete_if_empty(host, path.parent)
        host.run("systemctl", "stop", "ramstroke-sim.service")
    _write_configuration(host, CONFIGURATION, "ramstroke.toml")
    _link_command(host)
    for command in _MADE:
        host.run(*command)
    host.run("systemctl", "try-restart", "ramstroke.service", "ramstroke-view.service")  # an upgrade of what runs


def configuration_in_use(host: Host) -> Path:
    """Of the service that is installed: the trial's while that lasts."""
    return TRIAL_CONFIGURATION if host.has(TRIAL) else CONFIGURATION


def remove(host: Host, *, purge: bool) -> None:
    """Stop and take away the service; with `purge` configuration, recordings and learned state too."""
    units = [name for name, path in FILES.items() if path.parent == UNITS and host.has(path)]
    if units:
        host.run("systemctl", "disable", "--now", *units)
    for path in (*FILES.values(), REALTIME, *TRIALS, COMMAND):
        host.delete(path)
    drop_ins = [path.with_name(f"{name}.d") for name, path in FILES.items() if path.parent == UNITS]
    for folder in (*drop_ins, FILES["ramstroke.sysusers.conf"].parent):
        _delete_if_empty(host, folder)
    host.run("systemctl", "daemon-reload")
    host.run("udevadm", "control", "--reload")
    for path in (CONFIGURATION.parent, STATE, *drop_ins):
        if purge:
            host.delete(path)
        elif host.has(path):
            host.say(f"kept /{path}")


def shipped(name: str) -> str:
    """Text of a file of the folder systemd/, from the wheel or from the sources."""
    package = Path(__file__).parents[1]
    for folder in (package / "systemd", package.parent / "systemd"):
        if (folder / name).exists():
            return (folder / name).read_text(encoding="utf-8")
    raise CommandError(f"{name} is missing from this installation of ramstroke: install it again")


def _write_configuration(host: Host, path: Path, name: str) -> None:
    """From the examples that come with the program, unless there is one."""
    from importlib.resources import files

    if not host.has(path):
        host.write(path, (files("config") / name).read_text(encoding="utf-8"))


def _delete_if_empty(host: Host, folder: Path) -> None:
    """Others may have put files there, such as `systemctl edit`."""
    if host.has(folder) and not any((host.root / folder).iterdir()):
        host.delete(folder)


def fitted(name: str) -> str:
    """Text of a shipped file, which names the program where it is."""
    return shipped(name).replace(SHIPPED_PREFIX, sys.prefix)


def _link_command(host: Host) -> None:
    """So that `ramstroke` can be typed; a program of that name that is not ours stays."""
    target, program = host.root / COMMAND, Path(sys.prefix) / "bin" / "ramstroke"
    if target.is_symlink() and os.readlink(target) == str(program):
        return
    if target.exists() and not target.is_symlink():
        host.say(f"/{COMMAND} is another program and stays; ours is {program}")
        return
    host.delete(COMMAND)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.symlink_to(program)
    host.say(f"linked /{COMMAND} to {program}")


def start(host: Host) -> None:
    """Enable and start the service. Raises ConfigurationError if its configuration cannot be used, CommandError."""
    load(host.root / configuration_in_use(host))
    host.run("systemctl", "enable", "--now", "ramstroke.service")
    host.say("started: `systemctl status ramstroke`, `ramstroke status`")
