"""A CAN interface of the kernel as `ip` shows it, or as far as /sys tells: nobody's rights are needed for either."""

from __future__ import annotations

import json
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_SYS = Path("/sys/class/net")
_ARPHRD_CAN = 280  # linux/if_arp.h
_IFF_UP = 0x1
_PATIENCE_S = 5.0


@dataclass(slots=True, frozen=True)
class LinkFacts:
    """None: not known, or there is no such thing on a virtual interface."""

    exists: bool
    is_can: bool = False
    is_up: bool = False
    kind: str = ""  # "can", "vcan"
    bitrate: int | None = None
    state: str | None = None  # "error-active", "error-passive", "bus-off" ...
    transmit_errors: int | None = None
    receive_errors: int | None = None
    restart_ms: int | None = None
    is_listen_only: bool | None = None
    restarts: int | None = None
    received: int | None = None
    dropped: int | None = None


def can_interfaces() -> list[str]:
    """The names of all CAN interfaces of this computer."""

    def is_can(folder: Path) -> bool:
        try:
            return int((folder / "type").read_text()) == _ARPHRD_CAN
        except (OSError, ValueError):
            return False

    return sorted(folder.name for folder in _SYS.glob("*") if is_can(folder))


def read_link(name: str) -> LinkFacts:
    """How the interface is now."""
    if not (_SYS / name).exists():
        return LinkFacts(exists=False)
    with suppress(OSError, ValueError, LookupError, subprocess.SubprocessError):
        command = ["ip", "-details", "-statistics", "-json", "link", "show", "dev", name]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE_S, check=True)
        return link_of(json.loads(ended.stdout)[0])
    return _from_sys(_SYS / name)


def link_of(shown: dict[str, Any]) -> LinkFacts:
    """Out of one object of `ip -details -statistics -json link show`."""
    info = shown.get("linkinfo", {})
    data, events = info.get("info_data", {}), info.get("info_xstats", {})
    counters, received = data.get("berr_counter", {}), shown.get("stats64", shown.get("stats", {})).get("rx", {})
    state = data.get("state")
    kind = str(info.get("info_kind", ""))
    return LinkFacts(
        exists=True,
        is_can=shown.get("link_type") == "can" or kind in ("can", "vcan"),
        is_up="UP" in shown.get("flags", ()),
        kind=kind,
        bitrate=data.get("bittiming", {}).get("bitrate") or data.get("bittiming_bitrate"),
        state=None if state is None else str(state).lower(),
        transmit_errors=counters.get("tx"),
        receive_errors=counters.get("rx"),
        restart_ms=data.get("restart_ms", 0) if kind == "can" else None,
        is_listen_only="LISTEN-ONLY" in data.get("ctrlmode", ()) if kind == "can" else None,
        restarts=events.get("restarts"),
        received=received.get("packets"),
        dropped=received.get("dropped"),
    )


def _from_sys(folder: Path) -> LinkFacts:
    def number(name: str) -> int | None:
        try:
            return int((folder / name).read_text(), 0)
        except (OSError, ValueError):
            return None

    return LinkFacts(
        exists=True,
        is_can=number("type") == _ARPHRD_CAN,
        is_up=bool((number("flags") or 0) & _IFF_UP),
        received=number("statistics/rx_packets"),
        dropped=number("statistics/rx_dropped"),
    )
