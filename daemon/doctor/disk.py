"""Where the program writes: recordings, remembered state, live socket."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, Verdict, elsewhere, fault, not_checked, ok, warning
from daemon.doctor.rights import PASS, WRITE, User, nearest_folder, owners_of
from daemon.doctor.unit import Unit
from daemon.recording.retention import free_bytes, recordings
from daemon.recording.settings import RecorderSettings

FOLDER, SPACE, SPEED, STATE, SOCKET = (
    "recording folder",
    "free space",
    "write speed",
    "state file folder",
    "live socket",
)
NEEDED_KB_S = 60.0  # a live recording, all topics
_ENOUGH = 5.0  # times that
_PIECES, _PIECE = 16, 256 * 1024
_SLOW_SYNC_S = 1.0
_LONGEST_SOCKET = 107  # unix(7)
_LEAST_MB = 1.0  # less is a full disk, whatever is to be left free
_LOST = ("tmpfs", "ramfs", "overlay")
MEGA = 1_000_000


def look(patient: Patient) -> list[Check]:
    """All that is written to."""
    recording, service = patient.settings.recording, patient.settings.service
    if not recording.enabled:
        checks = [ok(FOLDER, "nothing is to be recorded: enabled = false in [recording]")]
    else:
        checks = [
            judge_folder(FOLDER, recording.directory, patient.user, "directory in [recording]", _sandbox(patient))
        ]
        place = nearest_folder(recording.directory)
        checks.append(judge_space(recording, free_bytes(place), _recorded_bytes(recording.directory)))
        if any(check.verdict is Verdict.FAULT for check in checks):
            checks.append(not_checked(SPEED, "it needs what stands above", "mend what stands above first"))
        else:
            checks.append(_speed(patient, place))
    folder = service.state_file.parent
    checks.append(judge_folder(STATE, folder, patient.user, "state_file in [service]", _sandbox(patient)))
    return [*checks, _socket(patient)]


def judge_folder(name: str, folder: Path, user: User, option: str, sandbox: Sequence[Path] | None = None) -> Check:
    """Whether that user may write there, or make it, and whether it outlasts a power-off.

    `sandbox`: the only folders that the service may write in at all; None: it may wherever its user may.
    """
    place = nearest_folder(folder)
    kind = kind_of(place, Path("/proc/mounts").read_text(errors="replace"))
    there = f"{folder} is there" if place == folder.absolute() else f"{folder} can be made in {place}"
    figures = {"file_system": kind}
    if not place.is_dir():
        return fault(name, f"{place} is no folder", f"correct {option}", **figures)
    if not user.is_me and not os.access(place, PASS):
        found = f"who asks may not look into {place}, which belongs to user {user.name}"
        return elsewhere(name, found, user.name)
    if not user.may(place, WRITE | PASS):
        advice = f"sudo install -d -o {user.name} {folder}, or correct {option}"
        return fault(name, f"user {user.name} may not write in {place} ({owners_of(place)})", advice, **figures)
    if os.statvfs(place).f_flag & os.ST_RDONLY:
        # After an error the kernel does that itself, and the disk wants to be looked at before anything else.
        point = _mount_point(place)
        advice = f"sudo mount -o remount,rw {point} if dmesg tells of no error of the disk, else replace it"
        return fault(name, f"{point} is mounted read-only", advice, **figures)
    if sandbox is not None and not any(folder.absolute().is_relative_to(one) for one in sandbox):
        advice = f"sudo systemctl edit ramstroke: there [Service] and ReadWritePaths={folder}, then restart the service"
        return fault(name, f"the service's sandbox does not let it write in {folder}", advice, **figures)
    refusal = write_refusal(place) if user.is_me else ""
    if refusal:
        return fault(
            name, f"{place} refuses to be written: {refusal}", f"mount it writable or correct {option}", **figures
        )
    if kind in _LOST:
        found = f"{there}, but on {kind}: all of it is lost when the computer is switched off"
        return warning(name, found, f"put it on a disk or card: {option}", **figures)
    return ok(name, f"{there}, on {kind}, and user {user.name} may write", **figures)


def _mount_point(place: Path) -> Path:
    found = place.resolve()
    while not found.is_mount():
        found = found.parent
    return found


def _sandbox(patient: Patient) -> Sequence[Path] | None:
    unit = patient.unit
    return unit.writable if isinstance(unit, Unit) else None


def write_refusal(folder: Path) -> str:
    """Why a file cannot be made there; empty if it can. The file is gone afterwards."""
    try:
        with _Probe(folder):
            return ""
    except OSError as error:
        return error.strerror or str(error)


def kind_of(place: Path, mounts: str) -> str:
    """The kind of file system that holds a folder, by the lines of /proc/mounts."""
    resolved = place.resolve()
    best, kind = -1, "an unknown file system"
    for line in mounts.splitlines():
        _, point, type_, *_ = [*line.split(), "", "", ""]
        mounted = point.replace("\\040", " ")
        if len(mounted) >= max(best, 1) and resolved.is_relative_to(mounted):
            best, kind = len(mounted), type_
    return kind


def judge_space(recording: RecorderSettings, free: int, recorded: int) -> Check:
    """Free space against what is to be left free and what recordings may take."""
    free_mb, recorded_mb = free / MEGA, recorded / MEGA
    figures = {"free_mb": round(free_mb), "recorded_mb": round(recorded_mb)}
    found = f"{free_mb:,.0f} MB free, {recorded_mb:,.0f} MB recorded; to be left free {recording.keep_free_mb:g} MB, "
    found += f"budget {recording.budget_mb:g} MB"
    if free_mb < max(recording.keep_free_mb, _LEAST_MB):
        if recorded_mb > recording.keep_free_mb - free_mb:
            return warning(SPACE, f"{found}: old recordings are deleted now", "make room, or copy them away", **figures)
        lower = ", or lower keep_free_mb in [recording]" if free_mb > _LEAST_MB else ""
        return fault(SPACE, found, f"make room on the disk, which others fill{lower}", **figures)
    if free_mb - recording.keep_free_mb + recorded_mb < recording.budget_mb:
        advice = "make room, or lower budget_mb in [recording] to what the disk can hold"
        return warning(SPACE, f"{found}: the budget does not fit", advice, **figures)
    return ok(SPACE, found, **figures)


def judge_speed(kb_s: float, slowest_sync_s: float) -> Check:
    """Measured speed and the longest time of one fdatasync."""
    figures = {"write_kb_s": round(kb_s), "slowest_sync_s": round(slowest_sync_s, 3)}
    found = (
        f"{kb_s:,.0f} kB/s with fdatasync, the slowest {slowest_sync_s:.2f} s; a recording needs {NEEDED_KB_S:g} kB/s"
    )
    advice = "use a faster disk or card, or see what else writes to it"
    if kb_s < NEEDED_KB_S:
        return fault(SPEED, found, advice, **figures)
    if kb_s < _ENOUGH * NEEDED_KB_S or slowest_sync_s > _SLOW_SYNC_S:
        return warning(SPEED, found, advice, **figures)
    return ok(SPEED, found, **figures)


def measure(folder: Path) -> tuple[float, float]:
    """Write 4 MB and push each piece to the disk: kB/s, and the slowest push [s]. Raises OSError."""
    slowest_s = 0.0
    piece = os.urandom(_PIECE)
    began_s = time.perf_counter()
    with _Probe(folder) as descriptor:
        for _ in range(_PIECES):
            os.write(descriptor, piece)
            before_s = time.perf_counter()
            os.fdatasync(descriptor)
            slowest_s = max(slowest_s, time.perf_counter() - before_s)
        return _PIECES * _PIECE / 1e3 / (time.perf_counter() - began_s), slowest_s


class _Probe:
    """A file of our own that is gone at the end, whatever happens."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / f".ramstroke-doctor-{os.getpid()}"

    def __enter__(self) -> int:
        self._descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        return self._descriptor

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)
        self._path.unlink(missing_ok=True)


def _speed(patient: Patient, place: Path) -> Check:
    patient.say("writing 4 MB")
    try:
        return judge_speed(*measure(place))
    except OSError as error:
        return not_checked(SPEED, f"{patient.me.name} cannot write in {place}: {error.strerror or error}")


def _socket(patient: Patient) -> Check:
    socket, unit = patient.settings.service.socket, patient.unit
    if len(os.fsencode(socket)) > _LONGEST_SOCKET:
        found = f"{socket} is longer than the {_LONGEST_SOCKET} bytes that a Unix socket may have"
        return fault(SOCKET, found, "choose a shorter socket in [service]")
    if patient.status is not None:
        return ok(SOCKET, f"the daemon answers on {socket}")
    is_made = isinstance(unit, Unit) and unit.runtime_folder and socket.is_relative_to(f"/run/{unit.runtime_folder}")
    if is_made:
        return ok(SOCKET, f"systemd makes {socket.parent} at each start")
    check = judge_folder(SOCKET, socket.parent, patient.user, "socket in [service]")
    # A socket is made anew at each start: it need not outlast a power-off.
    return (
        check
        if check.verdict is not Verdict.WARNING
        else ok(SOCKET, f"{socket.parent} can be written", **check.figures)
    )


def _recorded_bytes(folder: Path) -> int:
    try:
        return sum(path.stat().st_size for path in recordings(folder))
    except OSError:
        return 0
