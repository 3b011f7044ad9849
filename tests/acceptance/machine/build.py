"""Builds the acceptance machine into a cache folder outside the checkout.

Two layers: everything but the program, kept by a hash of these scripts and of the dependencies, and the image with
the program, kept by a hash of its wheel.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from tests.acceptance.machine.kernel import OWN_MODULES, fetch_kernel
from tests.acceptance.machine.root import (
    CHECKOUT,
    HERE,
    IMAGE_FILES,
    install_program,
    make_environment,
    make_image,
    make_initramfs,
    make_root,
)
from tests.acceptance.machine.tools import MachineError, require_tools, run

CACHE_VARIABLE = "RAMSTROKE_MACHINE"


@dataclass(frozen=True)
class Built:
    """What QEMU starts."""

    kernel: Path
    initramfs: Path
    image: Path
    wheel: Path  # of the program that is in the image
    wheels: Path  # folder with what it needs


def cache_folder() -> Path:
    """Where machines are kept."""
    chosen = os.environ.get(CACHE_VARIABLE)
    caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(chosen) if chosen else Path(caches) / "ramstroke-machine"


def build() -> Built:
    """The machine with the checkout's program in it, from the cache as far as it is there. Raises MachineError."""
    require_tools()
    cache = cache_folder()
    cache.mkdir(parents=True, exist_ok=True)
    with (cache / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return _build_in(cache)


def _build_in(cache: Path) -> Built:
    base = cache / f"base-{_key(_base_sources())}"
    if not base.exists():
        _build_base(base)
    program = base / "program"
    with tempfile.TemporaryDirectory(dir=cache) as scratch:
        built = build_wheel(CHECKOUT, Path(scratch))
        wheel = program / built.name
        image = base / f"image-{_key([built])}.ext4"
        if not image.exists():
            for old in base.glob("image-*"):
                old.unlink()
            shutil.rmtree(program, ignore_errors=True)
            program.mkdir()
            install_program(base / "root", built)
            shutil.copy(built, wheel)
            make_image(base / "root", image)
    return Built(base / "vmlinux", base / "initramfs", image, wheel, base / "wheels")


def build_wheel(sources: Path, folder: Path) -> Path:
    """The program's."""
    run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder], cwd=sources)
    (wheel,) = folder.glob("ramstroke-*.whl")
    return wheel


def build_next_version(folder: Path) -> Path:
    """A wheel of the same program under the next version's number."""
    with tempfile.TemporaryDirectory(prefix="ramstroke-next-") as scratch:
        sources = Path(scratch) / "sources"
        shutil.copytree(CHECKOUT, sources, ignore=shutil.ignore_patterns(".*", "tests", "docs", "__pycache__"))
        project = sources / "pyproject.toml"
        text, found = re.subn(r'(?m)^(version = "\d+\.\d+\.)(\d+)"$', _raised, project.read_text())
        if found != 1:
            raise MachineError(f'{project.name} has no line such as version = "0.1.0"')
        project.write_text(text)
        return build_wheel(sources, folder)


def _raised(version: re.Match[str]) -> str:
    return f'{version[1]}{int(version[2]) + 1}"'


def _build_base(base: Path) -> None:
    """All or nothing: a build that was broken off leaves no base."""
    for old in [*base.parent.glob("base-*"), *base.parent.glob("unfinished-*")]:
        shutil.rmtree(old)
    with tempfile.TemporaryDirectory(prefix="unfinished-", dir=base.parent) as scratch:
        work = Path(scratch)
        done = work / "done"
        done.mkdir()
        kernel = fetch_kernel(work / "kernel")
        make_root(done / "root", kernel)
        make_environment(done / "root", done / "wheels", work)
        make_initramfs(work, kernel, done / "initramfs")
        shutil.move(kernel.image, done / "vmlinux")
        done.rename(base)


def _base_sources() -> list[Path]:
    scripts = [HERE / f"{name}.py" for name in ("build", "kernel", "root")]
    files = [path for folder in (*OWN_MODULES, IMAGE_FILES) for path in sorted(folder.rglob("*")) if path.is_file()]
    project = [CHECKOUT / name for name in ("pyproject.toml", "constraints.txt")]
    return [*scripts, *files, *project]


def _key(paths: Iterable[Path]) -> str:
    digest = hashlib.sha256(sys.version.encode())
    for path in paths:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def main() -> int:
    """Build, and say how long it took."""
    started_s = time.monotonic()
    try:
        built = build()
    except MachineError as error:
        print(f"acceptance machine: {error}", file=sys.stderr)
        return 1
    print(f"acceptance machine: {built.image} after {time.monotonic() - started_s:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
