"""The service as systemd knows it."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

NAME = "ramstroke"
_BOOTED = Path("/run/systemd/system")  # sd_booted(3)
_PROPERTIES = (
    *("LoadState", "ActiveState", "SubState", "UnitFileState", "Result", "MainPID", "NRestarts"),
    *("WatchdogUSec", "ExecStart", "User", "LimitRTPRIO", "RuntimeDirectory", "FragmentPath"),
    *("ProtectSystem", "StateDirectory", "ReadWritePaths"),
)
_PATIENCE_S = 5.0


@dataclass(slots=True, frozen=True)
class Unit:
    """What `systemctl show` says; a service that is not installed has nothing but `is_installed`."""

    is_installed: bool
    is_enabled: bool = False
    state: str = ""  # active, inactive, failed ...
    result: str = ""
    main_pid: int = 0
    restarts: int = 0
    has_watchdog: bool = False
    configuration: Path | None = None  # None: the command names none
    user: str = ""
    realtime_limit: int = 0
    runtime_folder: str = ""  # below /run, made at each start
    file: Path | None = None
    writable: tuple[Path, ...] | None = None  # all folders that the sandbox lets it write in; None: it has no sandbox

    @property
    def is_active(self) -> bool:
        """Whether it runs, or is about to."""
        return self.state in ("active", "activating", "reloading")


def read_unit() -> Unit | str:
    """The service, or why nothing is known of it."""
    if not _BOOTED.is_dir():
        return "there is no systemd here"
    command = ["systemctl", "show", NAME, f"--property={','.join(_PROPERTIES)}"]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"systemctl does not answer ({error})"
    if ended.returncode != 0:
        return f"systemctl fails: {ended.stderr.strip() or ended.returncode}"
    return unit_of(ended.stdout)


def unit_of(shown: str) -> Unit:
    """Out of the lines KEY=VALUE that `systemctl show` prints."""
    values = dict(line.split("=", 1) for line in shown.splitlines() if "=" in line)
    if values.get("LoadState") != "loaded":
        return Unit(is_installed=False)
    named = re.search(r"--config[ =](\S+)", values.get("ExecStart", ""))
    return Unit(
        is_installed=True,
        is_enabled=values.get("UnitFileState", "").startswith("enabled"),
        state=values.get("ActiveState", ""),
        result=values.get("Result", ""),
        main_pid=_number(values.get("MainPID")),
        restarts=_number(values.get("NRestarts")),
        has_watchdog=values.get("WatchdogUSec", "0") not in ("", "0", "infinity"),
        configuration=Path(named.group(1)) if named else None,
        user=values.get("User", "") or "root",
        realtime_limit=_number(values.get("LimitRTPRIO")),
        runtime_folder=values.get("RuntimeDirectory", ""),
        file=Path(values["FragmentPath"]) if values.get("FragmentPath") else None,
        writable=_writable(values),
    )


def _writable(values: dict[str, str]) -> tuple[Path, ...] | None:
    """Of ProtectSystem=strict; weaker words protect no folder that recordings would go to."""
    if values.get("ProtectSystem") != "strict":
        return None
    paths = [word.lstrip("-+") for word in values.get("ReadWritePaths", "").split()]
    own = [
        f"{root}/{name}"
        for root, key in (("/var/lib", "StateDirectory"), ("/run", "RuntimeDirectory"))
        for name in values.get(key, "").split()
    ]
    return tuple(map(Path, paths + own))


def _number(text: str | None) -> int:
    return int(text) if text is not None and text.isdigit() else 0
