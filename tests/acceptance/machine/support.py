"""The virtual support behind the kernel's interfaces: what `ramstroke sim` is behind a socket.

Runs in the machine. Answers the SPI transfers that arrive at /dev/spi-user, drives the data-ready line through
/dev/data-ready, and sends the controller's frames on the configured CAN interface, all of one motion. The motion begins
with the first transfer, or when the file MOTION says, and goes on from there also after a restart.

The file FAULT says what goes wrong, until it is deleted:

    silent        transfers get no answer
    error         they fail
    late S        they are answered S seconds late
    product N     PROD_ID holds another number
    open          the data wire is open
    low           it stays low
    edges         no data-ready edges

ACCOUNT holds what was counted, violations of the data sheet among them, once a second.
"""

from __future__ import annotations

import asyncio
import errno
import json
import os
import select
import struct
import sys
import threading
import time
from collections import Counter
from pathlib import Path

from daemon.configuration import load
from daemon.simulation.virtual import ControllerTransmitter, virtual_controller, virtual_part, virtual_support
from drivers.adis16448.registers import REGISTERS
from drivers.clock import SystemClock
from drivers.virtual.part import VirtualPart

FOLDER = Path("/run/machine-support")
FAULT = FOLDER / "fault"
ACCOUNT = FOLDER / "account.json"
MOTION = Path("/var/lib/machine-support/began")  # wall clock [ns]

_QUESTION = struct.Struct("=QIIIBBBB")  # as in spi_user/spi-user.c
_ANSWER = struct.Struct("=Ii")
_LARGEST_QUESTION = _QUESTION.size + 4096
_MODE_3 = 3
_BURST = 0x3E
_BURST_SPEED_HZ, _REGISTER_SPEED_HZ = 1_000_000, 2_000_000
_PRODUCT = REGISTERS["PROD_ID"].address
# Before it is configured the part makes 819 edges a second, more than this machine can carry.
_SHORTEST_EDGE_S = 0.01
_POLL_S = 0.1


class Support:
    """Sensor, line and account; the counts are of this process."""

    def __init__(self, part: VirtualPart, port: int) -> None:
        self.counts: Counter[str] = Counter()
        self._part = part
        self._port = port  # descriptor
        self._asked_for = -1  # register of the frame before

    def serve_transfers(self) -> None:
        """Answer until the process ends."""
        port = self._port
        while True:
            select.select([port], [], [])
            try:
                question = os.read(port, _LARGEST_QUESTION)
            except BlockingIOError:  # the asker gave up
                continue
            asked_ns, number, length, speed_hz, mode, bits, cs_change, is_last = _QUESTION.unpack_from(question)
            data = question[_QUESTION.size :][:length]
            self._check(data, speed_hz, mode, bits, bool(cs_change), bool(is_last))
            answer = self._answer(data, speed_hz, asked_ns)
            if answer is None:
                self.counts["not answered"] += 1
                continue
            status = 0 if answer else -errno.EIO
            try:
                os.write(port, _ANSWER.pack(number, status) + answer)
            except OSError as error:
                if error.errno != errno.ESTALE:
                    raise
                self.counts["answered too late"] += 1

    def drive_line(self) -> None:
        """Pass the part's edges on until the process ends: low while the registers change, then high."""
        line = self._part.data_ready()
        wire = os.open("/dev/data-ready", os.O_WRONLY | os.O_CLOEXEC)
        while True:
            if line.wait(_POLL_S) is None or fault()[0] == "edges":
                continue
            os.write(wire, b"01")
            self.counts["edges"] += 1
            time.sleep(_SHORTEST_EDGE_S)

    def _check(self, data: bytes, speed_hz: int, mode: int, bits: int, cs_change: bool, is_last: bool) -> None:
        """What the data sheet forbids, and what no transfer of this program should have."""
        self.counts["transfers"] += 1
        is_burst = data[:1] == bytes([_BURST]) and len(data) > 2
        self.counts["bursts"] += is_burst
        fastest_hz = _BURST_SPEED_HZ if is_burst else _REGISTER_SPEED_HZ
        self.counts["violation: not SPI mode 3"] += mode != _MODE_3
        self.counts["violation: not 8 bits a word"] += bits != 8
        self.counts["violation: too fast"] += speed_hz > fastest_hz
        self.counts["violation: odd number of bytes"] += len(data) % 2
        self.counts["violation: chip select stays low"] += cs_change or not is_last

    def _answer(self, data: bytes, speed_hz: int, asked_ns: int) -> bytes | None:
        """Bytes; none if the port fails, None if nobody answers."""
        kind, value = fault()
        if kind == "silent":
            return None
        if kind == "error":
            return b""
        if kind in ("open", "low"):
            return (b"\xff" if kind == "open" else b"\x00") * len(data)
        if kind == "late":
            time.sleep(float(value))
        answer = self._part.transfer(data, speed_hz, asked_ns)
        if kind == "product" and self._asked_for == _PRODUCT:
            answer = int(value, 0).to_bytes(2, "big") + answer[2:]
        self._asked_for = data[0] & 0x7E if not data[0] & 0x80 else -1
        return answer


def fault() -> tuple[str, str]:
    """What goes wrong now, and its number."""
    try:
        kind, _, value = FAULT.read_text().strip().partition(" ")
    except OSError:
        return "", ""
    return kind, value


def motion_start_ns() -> int:
    """CLOCK_MONOTONIC at the begin of the motion: now, or when an earlier process began it."""
    now_ns, wall_ns = time.monotonic_ns(), time.time_ns()
    try:
        return now_ns - (wall_ns - int(MOTION.read_text()))
    except OSError:
        MOTION.parent.mkdir(exist_ok=True)
        MOTION.write_text(str(wall_ns))
        os.sync()  # a power cut must not forget it
        return now_ns


def write_account(counts: Counter[str]) -> None:
    """For the tests; whole or not at all."""
    partial = ACCOUNT.with_suffix(".partial")
    partial.write_text(json.dumps(dict(counts)))
    partial.replace(ACCOUNT)


async def main() -> None:
    """Play the support until the process is ended."""
    FOLDER.mkdir(exist_ok=True)
    settings = load(Path(sys.argv[1]))
    port = os.open("/dev/spi-user", os.O_RDWR | os.O_CLOEXEC)
    if not MOTION.exists():
        select.select([port], [], [])
    clock = SystemClock()
    virtual = virtual_support(settings, start_ns=motion_start_ns())
    support = Support(virtual_part(virtual, clock), port)
    sender = ControllerTransmitter(settings, virtual_controller(settings, virtual), clock)
    for work in (support.serve_transfers, support.drive_line):
        threading.Thread(target=work, daemon=True).start()
    sending = asyncio.ensure_future(sender.run())
    while not sending.done():
        write_account(support.counts | Counter({"frames": sender.sent, "frames failed": sender.failed}))
        await asyncio.sleep(1.0)
    await sending


if __name__ == "__main__":
    asyncio.run(main())
