"""What the acceptance machine's builder says and decides, without building one."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from tests.acceptance.machine.build import CACHE_VARIABLE, cache_folder
from tests.acceptance.machine.kernel import with_dependencies
from tests.acceptance.machine.tools import MachineError, require_tools


def test_missing_programs_are_named_with_the_command_that_installs_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def which(tool: str, path: str | None = None) -> str | None:
        return None if tool in ("mmdebstrap", "qemu-img") else f"/usr/bin/{tool}"

    monkeypatch.setattr(shutil, "which", which)
    with pytest.raises(MachineError) as caught:
        require_tools()
    assert str(caught.value) == (
        "the acceptance machine needs more programs: sudo apt-get install --no-install-recommends qemu-utils mmdebstrap"
    )


def test_it_says_that_it_needs_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda tool, path=None: f"/usr/bin/{tool}")
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(MachineError, match="run make acceptance as root"):
        require_tools()


def test_the_cache_lies_where_the_environment_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "ramstroke-machine"
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "elsewhere"))
    assert cache_folder() == tmp_path / "elsewhere"


def test_modules_come_after_those_that_they_need(tmp_path: Path) -> None:
    for name, needs in (("can-raw", "can"), ("can", ""), ("vcan", "can_dev"), ("can-dev", "")):
        (tmp_path / f"{name}.ko").write_bytes(b"\x7fELF license=GPL\0depends=" + needs.encode() + b"\0name=x\0")
    loaded = [path.stem for path in with_dependencies(tmp_path, ("can-raw", "vcan"))]
    assert loaded == ["can", "can-raw", "can-dev", "vcan"]
    with pytest.raises(MachineError, match="no module spi-petra"):
        with_dependencies(tmp_path, ("spi-petra",))
