"""Who may use a file: the service's user is rarely the one who asks the doctor."""

from __future__ import annotations

import grp
import os
import pwd
import stat
from dataclasses import dataclass
from pathlib import Path

READ, WRITE, PASS = 4, 2, 1


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


def nearest_folder(path: Path) -> Path:
    """The folder itself, or the nearest one above it that exists."""
    found = path.absolute()
    while not found.exists() and found != found.parent:
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
