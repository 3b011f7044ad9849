"""Debian's kernel for the machine: an ELF that starts at once, the few modules needed, and the tests' own ones."""

from __future__ import annotations

import lzma
import re
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from tests.acceptance.machine.tools import MachineError, run

OWN_MODULES = tuple(Path(__file__).parent / name for name in ("spi_user", "can_bus_off"))  # folders with sources
# In this order: the first ones are loaded before there is a root file system.
FOR_ROOT = ("virtio_pci", "virtio_blk", "crc32c_generic", "ext4")
FOR_TESTS = ("9p", "9pnet_virtio", "loop", "vcan", "can-raw", "kvaser_pci")
_XZ_MAGIC = b"\xfd7zXZ\x00"


@dataclass(frozen=True)
class Kernel:
    """A kernel, unpacked."""

    version: str
    image: Path
    modules: Path  # folder with all *.ko
    own_modules: tuple[Path, ...]


def fetch_kernel(folder: Path) -> Kernel:
    """Download the kernel that Debian has now, unpack it and build the tests' own modules for it."""
    version = _newest_version()
    packages = folder / "packages"
    packages.mkdir(parents=True)
    image = f"linux-image-{version}"
    headers = _with_dependencies(f"linux-headers-{version}")
    run(["apt-get", "-qq", "-o", "APT::Sandbox::User=root", "download", image, *headers], cwd=packages)
    for package in packages.glob("*.deb"):
        run(["dpkg-deb", "-x", package, folder / ("image" if package.name.startswith(image) else "headers")])
    shutil.rmtree(packages)
    unpacked = folder / "vmlinux"
    unpacked.write_bytes(_decompressed((folder / "image" / "boot" / f"vmlinuz-{version}").read_bytes()))
    own_modules = _build_own_modules(folder, version)
    return Kernel(version, unpacked, folder / "image" / "lib" / "modules" / version, own_modules)


def with_dependencies(modules: Path, names: Iterable[str]) -> list[Path]:
    """The files of these modules, each after those that it needs."""
    files = {_plain(path.stem): path for path in modules.rglob("*.ko")}
    ordered: list[Path] = []

    def add(name: str) -> None:
        path = files.get(_plain(name))
        if path is None:
            raise MachineError(f"this kernel has no module {name}")
        if path in ordered:
            return
        found = re.search(rb"(?:^|\x00)depends=([^\x00]*)\x00", path.read_bytes())
        for needed in filter(None, (found[1].decode() if found else "").split(",")):
            add(needed)
        ordered.append(path)

    for name in names:
        add(name)
    return ordered


def _plain(name: str) -> str:
    return name.replace("-", "_")


def _newest_version() -> str:
    """Such as 6.1.0-56-amd64; the variant for clouds has neither SPI nor CAN."""
    found = re.search(r"Depends: linux-image-(\S+)", run(["apt-cache", "depends", "linux-image-amd64"]))
    if found is None:
        raise MachineError("apt knows no kernel linux-image-amd64: run sudo apt-get update, on Debian 12")
    return found[1]


def _with_dependencies(headers: str) -> list[str]:
    needed = re.findall(r"Depends: (linux-(?:headers|kbuild|compiler)\S+)", run(["apt-cache", "depends", headers]))
    return [headers, *needed]


def _decompressed(image: bytes) -> bytes:
    start = image.find(_XZ_MAGIC)
    if start < 0:
        raise MachineError("this kernel is not packed with xz")
    return lzma.LZMADecompressor().decompress(image[start:])


def _build_own_modules(folder: Path, version: str) -> tuple[Path, ...]:
    tree = folder / "headers" / "usr" / "src" / f"linux-headers-{version}"
    # The headers lie elsewhere than where they would be installed.
    makefile = tree / "Makefile"
    makefile.write_text(makefile.read_text().replace("/usr/src/", f"{tree.parent}/"))
    built: list[Path] = []
    for sources in OWN_MODULES:
        build = folder / sources.name
        shutil.copytree(sources, build)
        run(["make", "-C", tree, f"M={build}", "modules"])
        built += build.glob("*.ko")
    return tuple(built)
