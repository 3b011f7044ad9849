"""Words to systemd over its notification socket (sd_notify(3)); silent where there is none."""

from __future__ import annotations

import os
import socket


class Notifier:
    """READY, STATUS, WATCHDOG and STOPPING of a Type=notify service."""

    def __init__(self, address: str | None = None) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET") if address is None else address
        self.watchdog_s = _watchdog_s()  # WatchdogSec; None: nobody waits for signs of life

    def ready(self) -> None:
        """The service has started."""
        self._send("READY=1")

    def stopping(self) -> None:
        """The service ends on purpose."""
        self._send("STOPPING=1")

    def watchdog(self) -> None:
        """A sign of life; call it only when data have moved."""
        self._send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """One line for `systemctl status`."""
        self._send(f"STATUS={' '.join(text.split())}")  # a line break would begin another assignment

    def _send(self, message: str) -> None:
        if not self._address:
            return
        # An address that begins with @ is in the abstract namespace.
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK  # a systemd that hangs must not hang us
        with socket.socket(socket.AF_UNIX, kind) as channel:
            try:
                channel.sendto(message.encode(), address)
            except OSError:
                return  # systemd has gone or does not listen: nothing depends on the words


def _watchdog_s() -> float | None:
    """Of sd_watchdog_enabled(3)."""
    limit_us, process = os.environ.get("WATCHDOG_USEC", ""), os.environ.get("WATCHDOG_PID", str(os.getpid()))
    if not limit_us.isdigit() or process != str(os.getpid()):
        return None
    return int(limit_us) * 1e-6 or None
