"""Programs of the host that the machine is made with and runs on."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

_PACKAGE_OF = {
    "qemu-system-x86_64": "qemu-system-x86",
    "qemu-img": "qemu-utils",
    "mmdebstrap": "mmdebstrap",
    "busybox": "busybox-static",
    "cpio": "cpio",
    "gcc-12": "gcc-12",
    "make": "make",
    "mke2fs": "e2fsprogs",
    "dpkg-deb": "dpkg",
}


class MachineError(Exception):
    """The machine cannot be made or does not run; the text is one sentence for a person."""


def require_tools() -> None:
    """Raises MachineError with the command that installs what is missing."""
    missing = [package for tool, package in _PACKAGE_OF.items() if shutil.which(tool, path=_path()) is None]
    if missing:
        raise MachineError(
            "the acceptance machine needs more programs: sudo apt-get install --no-install-recommends "
            + " ".join(missing)
        )
    if os.geteuid() != 0:
        raise MachineError("the acceptance machine's root file system is made by root: run make acceptance as root")


def run(command: Sequence[str | Path], *, cwd: Path | None = None) -> str:
    """Run a program without the caller's Python and pip settings; returns what it printed.

    Raises MachineError.
    """
    words = [str(word) for word in command]
    ended = subprocess.run(
        words, cwd=cwd, env=_environment(), stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace"
    )
    if ended.returncode:
        tail = "\n".join((ended.stdout + ended.stderr).splitlines()[-30:])
        raise MachineError(f"`{' '.join(words)}` failed with exit code {ended.returncode}:\n{tail}")
    return ended.stdout


def _path() -> str:
    return os.environ.get("PATH", "") + ":/usr/sbin:/sbin"


def _environment() -> dict[str, str]:
    """Python in a changed root would take the host's settings for its own."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PIP_", "PYTHON", "VIRTUAL_ENV"))}
    return kept | {"PATH": _path(), "LC_ALL": "C.UTF-8"}
