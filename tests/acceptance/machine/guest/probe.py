"""What a service's sandbox lets a program do: run in its place, answers on standard output."""

from __future__ import annotations

import json
import mmap
import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


def answer(attempt: Callable[[], Any]) -> str:
    """ "yes", or the error's name."""
    try:
        attempt()
    except Exception as error:
        number = getattr(error, "errno", None)
        return type(error).__name__ if number is None else str(os.strerror(number))
    return "yes"


def write(path: str) -> Callable[[], Any]:
    return lambda: Path(path).write_text("x")


def read(path: str) -> Callable[[], Any]:
    return lambda: os.close(os.open(path, os.O_RDWR))


def main() -> None:
    """Try everything."""
    found = {
        "own folder": answer(write("/var/lib/ramstroke/own")),
        "own run folder": answer(write("/run/ramstroke/own")),
        "temporary folder": answer(write("/tmp/own")),
        "recordings": answer(lambda: min(Path("/var/lib/ramstroke/recordings").glob("*.mcap")).read_bytes()),
        "numpy": answer(lambda: np.linalg.inv(np.eye(10) + 1)),
        "unix socket": answer(lambda: socket.socket(socket.AF_UNIX).close()),
        "can socket": answer(lambda: socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).bind(("vcan0",))),
        "spi port": answer(read("/dev/spidev0.0")),
        "gpio chip": answer(read("/dev/gpiochip0")),
        "write /etc": answer(write("/etc/ramstroke/x")),
        "write /usr": answer(write("/usr/x")),
        "write /var/lib": answer(write("/var/lib/x")),
        "write /opt": answer(write("/opt/ramstroke/x")),
        "write /home": answer(write("/home/x")),
        "read /root": answer(lambda: os.listdir("/root")),
        "internet socket": answer(lambda: socket.socket(socket.AF_INET).close()),
        "internet 6 socket": answer(lambda: socket.socket(socket.AF_INET6).close()),
        "packet socket": answer(lambda: socket.socket(socket.AF_PACKET, socket.SOCK_RAW).close()),
        "disk": answer(read("/dev/vda")),
        "other device": answer(read("/dev/vport0p1")),
        "kernel log": answer(read("/dev/kmsg")),
        "writable code": answer(lambda: mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)),
        "real-time priority": answer(lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))),
        "other processes": answer(lambda: os.listdir("/proc/1/fd")),
        "set the clock": answer(lambda: __import__("time").clock_settime(0, 0.0)),
        "seen temporary files": str(os.listdir("/tmp")),
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main()
