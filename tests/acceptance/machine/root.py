"""The machine's root file system: Debian 12, the program's dependencies, and what lets a test command in."""

from __future__ import annotations

import gzip
import os
import shutil
import sys
from pathlib import Path

from tests.acceptance.machine.kernel import FOR_ROOT, FOR_TESTS, Kernel, with_dependencies
from tests.acceptance.machine.tools import run

HERE = Path(__file__).parent
CHECKOUT = HERE.parents[2]
IMAGE_FILES = HERE / "image"
BIN = "/opt/ramstroke/bin"
_PACKAGES = "systemd,systemd-sysv,dbus,udev,kmod,iproute2,can-utils,python3,python3-venv,procps,gpiod"
_FOR_TESTS = ("pytest", "pytest-timeout")
# Nothing that the program needs, and slow without a hardware's help.
_MASKED = (
    "apt-daily.timer",
    "apt-daily-upgrade.timer",
    "dpkg-db-backup.timer",
    "e2scrub_all.timer",
    "e2scrub_reap.service",
    "fstrim.timer",
    "getty@tty1.service",
    "getty.target",
    "systemd-logind.service",
    "systemd-user-sessions.service",
    "systemd-update-utmp.service",
    "systemd-journal-flush.service",
    "systemd-pstore.service",
    "systemd-binfmt.service",
    "systemd-firstboot.service",
    "systemd-sysusers.service",
    "systemd-repart.service",
    "systemd-random-seed.service",
    "modprobe@loop.service",
    "modprobe@dm_mod.service",
    "modprobe@fuse.service",
    "modprobe@drm.service",
    "modprobe@efi_pstore.service",
    "dev-hugepages.mount",
    "dev-mqueue.mount",
    "sys-kernel-debug.mount",
    "sys-kernel-tracing.mount",
    "systemd-timesyncd.service",
    "systemd-network-generator.service",
)


def make_root(root: Path, kernel: Kernel) -> None:
    """Debian, modules, and the command's door; the installer does the rest there."""
    run(
        ["mmdebstrap", "--quiet", "--variant=minbase", "--mode=root", f"--include={_PACKAGES}"]
        + [f"--dpkgopt=path-exclude=/usr/share/{name}/*" for name in ("man", "doc", "locale")]
        + ['--aptopt=Apt::Install-Recommends "false"', "bookworm", root]
    )
    modules = root / "lib" / "modules" / kernel.version
    modules.mkdir(parents=True)
    for path in with_dependencies(kernel.modules, (*FOR_ROOT, *FOR_TESTS)):
        shutil.copy(path, modules)
    for path in kernel.own_modules:
        shutil.copy(path, modules)
    for path in kernel.modules.glob("modules.*"):
        shutil.copy(path, modules)
    _in(root, "depmod", kernel.version)

    (root / "etc" / "fstab").write_text("")
    for unit in _MASKED:
        (root / "etc/systemd/system" / unit).symlink_to("/dev/null")
    shutil.copytree(IMAGE_FILES, root, dirs_exist_ok=True)
    _in(root, "systemctl", "enable", "machine-command.service")


def make_environment(root: Path, wheels: Path, scratch: Path) -> None:
    """Everything in /opt/ramstroke but the program itself; its packages stay in `wheels`, as for an offline install."""
    constraints = str(CHECKOUT / "constraints.txt")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "wheel", "-c", constraints]
    run([*pip, "--wheel-dir", wheels, f"{CHECKOUT}[hardware,view]"], cwd=scratch)
    for own in wheels.glob("ramstroke-*.whl"):
        own.unlink()
    seen = root / "wheels"
    shutil.copytree(wheels, seen)
    run([*pip, "--wheel-dir", seen, *_FOR_TESTS], cwd=scratch)
    _in(root, "python3", "-m", "venv", "/opt/ramstroke")
    names = [f"/wheels/{path.name}" for path in seen.glob("*.whl")]
    _in(root, f"{BIN}/pip", "--quiet", "install", "--no-index", "--no-deps", *names)
    shutil.rmtree(seen)


def install_program(root: Path, wheel: Path) -> None:
    """Put this build of the program in the place of the one before."""
    shutil.copy(wheel, root / wheel.name)
    _in(root, f"{BIN}/pip", "--quiet", "install", "--no-index", "--no-deps", "--force-reinstall", f"/{wheel.name}")
    (root / wheel.name).unlink()
    _in(root, f"{BIN}/pip", "--quiet", "check")


def make_image(root: Path, image: Path) -> None:
    """An ext4 file system of that tree, thinly filled."""
    partial = image.with_suffix(".partial")
    partial.unlink(missing_ok=True)
    options = ["-q", "-t", "ext4", "-O", "^metadata_csum", "-m", "0", "-L", "root"]
    run(["mke2fs", *options, "-d", root, partial, "900M"])
    partial.rename(image)


def make_initramfs(folder: Path, kernel: Kernel, initramfs: Path) -> None:
    """Loads what the root file system needs and goes there."""
    tree = folder / "initramfs-tree"
    for name in ("bin", "dev", "proc", "root"):
        (tree / name).mkdir(parents=True)
    busybox = shutil.which("busybox")
    assert busybox is not None
    shutil.copy(busybox, tree / "bin" / "busybox")
    loading = []
    for path in with_dependencies(kernel.modules, FOR_ROOT):
        shutil.copy(path, tree)
        loading.append(f"$b insmod /{path.name}")
    init = tree / "init"
    init.write_text(
        "\n".join(
            [
                "#!/bin/busybox sh",
                "b=/bin/busybox",
                "$b mount -t proc proc /proc",
                "$b mount -t devtmpfs dev /dev",
                *loading,
                "until [ -b /dev/vda ]; do $b sleep 0.1; done",
                "$b mount -t ext4 /dev/vda /root",
                "$b mount --move /dev /root/dev",
                "$b umount /proc",
                "exec $b switch_root /root /sbin/init",
            ]
        )
        + "\n"
    )
    init.chmod(0o755)
    names = "\n".join(str(path.relative_to(tree)) for path in sorted(tree.rglob("*")))
    (folder / "initramfs-names").write_text(names + "\n")
    archive = folder / "initramfs-archive"
    run(["sh", "-c", f"cd {tree} && cpio -o -H newc -R 0:0 --quiet < {folder}/initramfs-names > {archive}"])
    initramfs.write_bytes(gzip.compress(archive.read_bytes(), 6))
    os.unlink(archive)


def _in(root: Path, *command: str) -> None:
    """Run a program of the new system within it."""
    run(["env", "-i", "PATH=/usr/sbin:/usr/bin:/sbin:/bin", "HOME=/root", "LC_ALL=C.UTF-8", "chroot", root, *command])
