"""Making a complete file out of a cut or damaged one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from daemon.recording.errors import refuse_same_file
from daemon.recording.reader import Recording
from daemon.recording.writer import RecordingWriter

_PROGRESS_EVERY = 10_000


@dataclass(slots=True, frozen=True)
class RecoveryReport:
    """What was saved: messages written, messages known to be missing, and what was wrong with the file."""

    messages: int
    lost: int
    damage: list[str]


def recover(source: Path, target: Path, progress: Callable[[float], None] | None = None) -> RecoveryReport:
    """Write every readable message of `source` byte for byte, with its description, to a new file `target`.

    Sequence numbers stay, so that gaps remain visible. progress: hears the share of the file that has been read.
    Raises `RecordingError`; `target` is written whole or not at all.
    """
    refuse_same_file(source, target)
    recording = Recording(source)
    messages = 0
    with RecordingWriter(target, recording.metadata, recording.attachments) as writer:
        for messages, (channel, sequence, t_ns, payload) in enumerate(recording.raw_messages(), start=1):
            writer.write_raw(channel, t_ns, sequence, payload)
            if progress is not None and messages % _PROGRESS_EVERY == 0:
                progress(recording.share_read)
    return RecoveryReport(messages, recording.lost, recording.damage)
