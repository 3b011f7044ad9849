"""The file of a device: is it there, may it be used, and has nobody else got it open?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from daemon.doctor.report import Check, elsewhere, fault
from daemon.doctor.rights import READ, WRITE, User, group_of, groups_to_join, holders, owners_of


@dataclass(slots=True, frozen=True)
class Node:
    """What a device file is called in checks and in the configuration."""

    check: str
    path: Path
    option: str  # "spi_device in [imu]"
    switch_on: str  # what makes it appear
    alike: str  # pattern of others of its kind in /dev
    is_shared: bool = False  # several programs may have it open
    companions: tuple[Path, ...] = ()  # other devices of the same part, whose groups are told with this one's


def examine(node: Node, user: User) -> Check | None:
    """What is wrong with it; None if nothing is. Nothing is opened."""
    path = node.path
    if not path.exists():
        others = _others(node)
        if others:
            found, advice = (
                f"there is no {path}, but {', '.join(others)}",
                f"correct {node.option}, or {node.switch_on}",
            )
            return fault(node.check, found, advice)
        return fault(node.check, f"there is no {path}", f"{node.switch_on}, or correct {node.option}")
    if not path.is_char_device():
        return fault(node.check, f"{path} is no device", f"correct {node.option}")
    if not user.may(path, READ | WRITE):
        return fault(
            node.check,
            f"user {user.name} may not use {path} ({owners_of(path)})",
            groups_to_join(user, (path, *node.companions)),
            group=group_of(path),
        )
    # A pseudo-terminal is held open by whoever plays the device.
    held = [] if node.is_shared or path.resolve().is_relative_to("/dev/pts") else holders(path)
    if held:
        return fault(
            node.check, f"{path} is in use by {' and '.join(held)}", "end that program: it disturbs every transfer"
        )
    return None


def not_mine(node: Node, user: User, me: User) -> Check | None:
    """A device that the service may use, and who asks may not: rights are well, and that is all one can say."""
    if user.is_me or me.may(node.path, READ | WRITE):
        return None
    found = f"{node.path} is there and user {user.name} may use it, but {me.name}, who asks, may not"
    return elsewhere(node.check, found, user.name)


def _others(node: Node) -> Sequence[str]:
    return [str(path) for path in sorted(Path("/dev").glob(node.alike)) if path != node.path][:4]
