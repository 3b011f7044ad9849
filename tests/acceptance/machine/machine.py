"""Starts the machine, lets it run one command, and brings back what came of it."""

from __future__ import annotations

import subprocess
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from tests.acceptance.machine.build import Built
from tests.acceptance.machine.tools import MachineError, run

# No KVM: a /dev/kvm that opens may still not work, and everything here must pass on the slowest machine anyway.
# The machine's clock counts instructions, a nanosecond each: how busy the host is changes nothing in the machine but
# how long it takes. It leaps over idle time, which is also time that is spent waiting for disk and shared folder: a
# machine that reads much must not leap. A processor without AVX, whose emulation is slower.
_HARDWARE = [
    *("-accel", "tcg,thread=single,tb-size=512"),
    *("-machine", "pc,hpet=off,vmport=off"),
    *("-cpu", "Nehalem"),
    *("-m", "1024"),
    *("-nodefaults", "-no-reboot"),
    *("-display", "none"),
    *("-device", "virtio-rng-pci"),
    *("-device", "isa-debug-exit,iobase=0xf4,iosize=1"),
    # Two CAN controllers on one bus: can0 and can1.
    *("-object", "can-bus,id=bus"),
    *("-device", "kvaser_pci,canbus=bus"),
    *("-device", "kvaser_pci,canbus=bus"),
]
_KERNEL_LINE = (
    "console=ttyS0 panic=-1 mitigations=off edd=off tsc=reliable no_timer_check quiet loglevel=4 "
    "systemd.show_status=0 systemd.firstboot=off"
)


@dataclass(frozen=True)
class Outcome:
    """How a command in the machine ended."""

    code: int | None  # of the command; None: the machine crashed or was too slow
    output: str
    journal: str
    duration_s: float
    ending: str = ""  # of a machine that crashed or was too slow, in words


def run_in_machine(
    built: Built,
    share: Path,
    timeout_s: float,
    disk: Path | None = None,
    began: datetime | None = None,
    *,
    leaps: bool = True,
) -> Outcome:
    """Run `share/command` in a fresh machine that sees `share` as /share.

    Args:
        built: the machine.
        share: folder of the host; the command's results stay there.
        timeout_s: of the whole run.
        disk: overlay of `overlay()` that outlasts the run; without it the disk forgets everything.
        began: what the machine's clock says when it starts; now by default.
        leaps: its clock leaps over idle time.
    """
    output, console, journal = share / "output.txt", share / "console.txt", share / "journal.txt"
    for old in (output, console, journal):
        old.unlink(missing_ok=True)
    drive = f"file={built.image},format=raw,snapshot=on" if disk is None else f"file={disk},format=qcow2,snapshot=off"
    command = ["qemu-system-x86_64", *_HARDWARE, "-kernel", str(built.kernel), "-initrd", str(built.initramfs)]
    clock = (began or datetime.now(UTC)).strftime("%Y-%m-%dT%H:%M:%S")
    command += [
        "-icount",
        f"shift=0,sleep={'off' if leaps else 'on'}",
        "-rtc",
        f"base={clock},clock=vm",
        "-append",
        _KERNEL_LINE,
        "-drive",
        f"{drive},if=virtio,cache=unsafe",
        "-serial",
        f"file:{console}",
    ]
    command += ["-virtfs", f"local,path={share},mount_tag=share,security_model=none,multidevs=remap"]
    _warm(built.image)
    started_s = time.monotonic()
    try:
        ended = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except subprocess.TimeoutExpired:
        exit_code, said, ending = None, "", f"too slow: not done after {timeout_s:.0f} s"
    else:
        exit_code, said = ended.returncode, ended.stderr
        ending = f"QEMU ended with {exit_code}, below zero a signal: {said.strip() or 'nothing said'}"
    duration_s = time.monotonic() - started_s
    # isa-debug-exit makes 2 x code + 1 of the code.
    code = exit_code // 2 if exit_code is not None and exit_code % 2 else None
    if code is None and not console.exists():
        raise MachineError(f"qemu-system-x86_64 does not start: {said.strip()}")
    return Outcome(code, _text(output), _text(journal) or _text(console), duration_s, ending)


def _warm(image: Path) -> None:
    """Read the disk into the host's memory: while a machine waits for its disk it is idle, and its clock leaps."""
    with image.open("rb") as stream:
        while stream.read(1 << 24):
            pass


def overlay(built: Built, path: Path) -> Path:
    """A disk on top of the machine's that keeps what is written to it."""
    run(["qemu-img", "create", "-q", "-f", "qcow2", "-b", built.image, "-F", "raw", path])
    return path


def _text(path: Path) -> str:
    return path.read_text(errors="replace") if path.exists() else ""
