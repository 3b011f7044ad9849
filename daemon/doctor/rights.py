"""Who may use a file: the service's user is rarely the one who asks the doctor."""

from __future__ import annotations

import grp
import os
import pwd
import stat
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

READ, WRITE, PASS = 4, 2, 1
# By its place: before the first installation no `ramstroke` can be typed, least of all behind sudo.
INSTALL = f"sudo {sys.prefix}/bin/ramstroke install-service"
_ROOT = 0


@dataclass(slots=True, frozen=True)
class User:
    """Somebody whose rights are asked for."""

    name: str
    uid: int
    groups: frozenset[int]
    is_me: bool

    def may(self, path: Path, need: int) -> bool:
        """Whether the mode of an existing file grants all of `need`; False if it cannot be looked at."""
        if self.is_me:
            return os.access(path, need)
        if self.uid == 0:
            return True
        try:
            about = path.stat()
        except OSError:
            return False
        shift = 6 if about.st_uid == self.uid else 3 if about.st_gid in self.groups else 0
        return about.st_mode >> shift & need == need


def this_user() -> User:
    """Who runs this program."""
    uid = os.geteuid()
    return User(_user_name(uid), uid, frozenset({os.getegid(), *os.getgroups()}), True)


def named_user(name: str) -> User | None:
    """A user of this computer with the groups that a service would get; None: there is none."""
    try:
        entry = pwd.getpwnam(name)
    except KeyError:
        return None
    groups = frozenset(os.getgrouplist(name, entry.pw_gid))
    return User(name, entry.pw_uid, groups, entry.pw_uid == os.geteuid())


def group_of(path: Path) -> str:
    """Name of the group that owns a file."""
    gid = path.stat().st_gid
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def owners_of(path: Path) -> str:
    """Owner, group and mode as `ls -l` shows them."""
    about = path.stat()
    return f"{_user_name(about.st_uid)}:{group_of(path)} {stat.filemode(about.st_mode)}"


def groups_to_join(user: User, paths: Iterable[Path]) -> str:
    """What lets the user read and write these devices: one command for all of them."""
    refused = [path for path in paths if path.exists() and not user.may(path, READ | WRITE)]
    if any(not _has_group(path) for path in refused):
        return f"{INSTALL} gives such devices to a group of their own, and the service's user to that group"
    groups = ",".join(sorted({group_of(path) for path in refused}))
    then = "log in again" if user.is_me else "sudo systemctl try-restart ramstroke"
    return f"sudo usermod -aG {groups} {user.name}, then {then}"


def _has_group(path: Path) -> bool:
    """Whether the members of a group that one may join can use it."""
    about = path.stat()
    return about.st_gid != _ROOT and about.st_mode >> 3 & (READ | WRITE) == READ | WRITE


def nearest_folder(path: Path) -> Path:
    """The folder itself, or the nearest one above it that exists, as far as who asks may look."""
    found = path.absolute()
    while not os.path.exists(found) and found != found.parent:
        found = found.parent
    return found


def holders(path: Path) -> list[str]:
    """Programs that have a device open, as far as this user may see them."""
    wanted, own = os.path.realpath(path), os.getpid()
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        if int(process.name) == own:
            continue
        try:
            links = [os.readlink(link) for link in (process / "fd").iterdir()]
            if wanted in links:
                found.append(f"{(process / 'comm').read_text().strip()} (process {process.name})")
        except OSError:  # another user's, or gone meanwhile
            continue
    return found


def _user_name(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)
