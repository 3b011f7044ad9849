"""What the tests in the machine share: devices, service, journal."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from daemon.errors import CommandError
from daemon.service.live_client import first_line

T = TypeVar("T")

SHARE = Path("/share")
RESULTS = SHARE / "results"
HERE = Path(__file__).parent
RAMSTROKE = "/opt/ramstroke/bin/ramstroke"
CONFIG = Path("/etc/ramstroke/ramstroke.toml")
RECORDINGS = Path("/var/lib/ramstroke/recordings")
LIVE = Path("/run/ramstroke/live.sock")
FAULT = Path("/run/machine-support/fault")
ACCOUNT = Path("/run/machine-support/account.json")
# Of an emulated machine that shares its processors; no test measures time.
PATIENCE_S = 120.0

# Only what an emulated processor needs: more time.
_DROP_IN = "[Service]\nWatchdogSec=30\nTimeoutStartSec=300\nTimeoutStopSec=120\n"


def run(*command: str | Path, code: int = 0) -> str:
    """Run a program that must end with `code`; what it said on standard output."""
    ended = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    assert ended.returncode == code, f"{command}: {ended.returncode}\n{ended.stdout}{ended.stderr}"
    return ended.stdout


def wait_for(what: str, probe: Callable[[], T], patience_s: float = PATIENCE_S) -> T:
    """The first answer that counts as true."""
    deadline_s = time.monotonic() + patience_s
    while not (found := probe()):
        if time.monotonic() > deadline_s:
            raise AssertionError(f"not within {patience_s:.0f} s: {what}")
        time.sleep(0.5)
    return found


def load_devices() -> None:
    """The SPI port and the data-ready line appear."""
    run("modprobe", "spi-user")
    run("udevadm", "settle")


def add_bus() -> None:
    """vcan0 appears, and is up."""
    run("modprobe", "-a", "vcan", "can-raw")
    run("ip", "link", "add", "dev", "vcan0", "type", "vcan")
    run("ip", "link", "set", "vcan0", "up")


def start_support(config: Path = CONFIG) -> None:
    """The virtual support, which begins to move ten seconds after it was first asked something."""
    script = HERE.parent / "support.py"
    unit = ["systemd-run", "--quiet", "--unit=machine-support", "--property=Restart=no", f"--working-directory={SHARE}"]
    run(*unit, sys.executable, "-P", script, config)


def exchange_support() -> None:
    """Another one takes its place, which begins from rest."""
    Path("/var/lib/machine-support/began").unlink()
    start_support()


def write_config(path: Path, channel: str) -> None:
    """The configuration of this folder, for another CAN interface."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = (HERE / "ramstroke.toml").read_text()
    path.write_text(text.replace('channel = "vcan0"', f'channel = "{channel}"'))


def install_service(channel: str = "vcan0") -> None:
    """As docs/installation.md says, with the configuration of this folder."""
    write_config(CONFIG, channel)
    allow_slowness()
    run(RAMSTROKE, "install-service")


def allow_slowness() -> None:
    """The service has more time than its unit gives."""
    slow = Path("/etc/systemd/system/ramstroke.service.d/slow-machine.conf")
    slow.parent.mkdir(exist_ok=True)
    slow.write_text(_DROP_IN)
    run("systemctl", "daemon-reload")


def set_up() -> None:
    """A computer that is ready: devices, bus, the service, which is not started, and the support."""
    load_devices()
    add_bus()
    install_service()
    start_support()


def start_service() -> None:
    """Returns when it says READY."""
    run("systemctl", "start", "ramstroke")


def properties(*names: str, unit: str = "ramstroke") -> dict[str, str]:
    """What systemd says of the service, or of another unit."""
    said = run("systemctl", "show", unit, f"--property={','.join(names)}")
    return dict(line.split("=", 1) for line in said.splitlines())


def status() -> dict[str, Any]:
    """The daemon's own; empty while none answers."""
    try:
        return first_line(LIVE)
    except CommandError:
        return {}


def state_of(part: str) -> str:
    """The word for a part of the daemon."""
    found = status().get(part)
    return str(found["state"]) if found else "gone"


def account() -> dict[str, int]:
    """What the virtual support counted."""
    counts: dict[str, int] = json.loads(ACCOUNT.read_text())
    return counts


def set_fault(words: str) -> None:
    """Something goes wrong with the sensor from now on; nothing if empty."""
    if not words:
        FAULT.unlink(missing_ok=True)
        return
    partial = FAULT.with_suffix(".partial")
    partial.write_text(words)
    partial.replace(FAULT)


def in_the_sandbox_of(service: str) -> dict[str, str]:
    """What a program in the place of the service's own may do: `probe.py`, run by the same unit."""
    text = Path(f"/etc/systemd/system/{service}.service").read_text()
    text = re.sub(r"(?m)^Type=.*$", "", text).replace("[Service]", "[Service]\nType=oneshot")
    text = re.sub(r"(?m)^(WatchdogSec|Restart|RestartSec|RestartPreventExitStatus)=.*$", "", text)
    shutil.copy(HERE / "probe.py", "/opt/probe.py")
    text = re.sub(r"(?m)^ExecStart=.*$", "ExecStart=/opt/ramstroke/bin/python /opt/probe.py", text)
    Path("/etc/systemd/system/probe.service").write_text(text)
    Path("/tmp/somebody-elses").write_text("x")
    run("systemctl", "daemon-reload")
    run("systemctl", "start", "probe")
    (said,) = (
        line
        for line in run("journalctl", "--unit=probe", "--output=cat", "--no-pager").splitlines()
        if line.startswith("{")
    )
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"sandbox-{service}.json").write_text(said)
    found: dict[str, str] = json.loads(said)
    return found


class Journal:
    """The service's lines from now on, as one program follows them: to ask again and again costs too much here."""

    def __init__(self) -> None:
        self._path = Path(tempfile.mkstemp(prefix="journal-")[1])
        words = ["journalctl", "--follow", "--lines=0", "--output=cat", "--unit=ramstroke"]
        with self._path.open("w") as file:
            self._follower = subprocess.Popen(words, stdout=file)
        time.sleep(2.0)  # until it follows

    def lines(self) -> list[str]:
        """What program and systemd said since."""
        return self._path.read_text().splitlines()

    def wait_for(self, piece: str, patience_s: float = PATIENCE_S) -> str:
        """The first line with that piece."""

        def found() -> str:
            return next((line for line in self.lines() if piece in line), "")

        return wait_for(f'"{piece}" in the journal', found, patience_s)

    def close(self) -> None:
        """End the following."""
        self._follower.terminate()
        self._follower.wait()


def keep(path: Path) -> None:
    """Copy a file to the host."""
    RESULTS.mkdir(exist_ok=True)
    shutil.copy(path, RESULTS)
