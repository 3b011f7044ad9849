"""What a replay can write: a recording, a table of steps."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from daemon.offline.replay import ReplayResult, replay
from daemon.recording import topics
from daemon.recording.errors import failed, refuse_same_file
from daemon.recording.metadata import LEARNED, SNAPSHOT
from daemon.recording.reader import Recording
from daemon.recording.topics import Recorded
from daemon.recording.writer import RecordingWriter
from daemon.settings import Settings
from daemon.stream import Sink
from estimation.records import Estimate

COLUMNS = (
    "t_s",
    "displacement_mm",
    "sigma_mm",
    "velocity_mm_s",
    "velocity_sigma_mm_s",
    "segment",
    "tier",
    "can_state",
)


def replay_to(
    source: Path,
    settings: Settings | None = None,
    *,
    output: Path | None = None,
    table: Path | None = None,
    provisional: bool = False,
    progress: Callable[[int], None] | None = None,
) -> ReplayResult:
    """Replay `source` and write what was asked for, each file whole or not at all. Raises RecordingError."""
    sinks: list[Sink] = []
    with ExitStack() as stack:
        if output is not None:
            sinks.append(stack.enter_context(_recording_sink(source, output, settings)))
        if table is not None:
            refuse_same_file(source, table)
            wanted = topics.PROVISIONAL if provisional else topics.SETTLED
            sinks.append(stack.enter_context(_table_sink(table, wanted)))

        def receive(topic: str, record: Recorded) -> None:
            for sink in sinks:
                sink(topic, record)

        return replay(source, settings, receive, progress)


@contextmanager
def _recording_sink(source: Path, output: Path, settings: Settings | None) -> Iterator[Sink]:
    refuse_same_file(source, output)
    recording = Recording(source)
    metadata = dict(recording.metadata)
    attachments = {LEARNED: recording.attachments.get(LEARNED, b"{}")}
    if settings is not None:
        metadata["settings"] = settings.model_dump_json()
    elif SNAPSHOT in recording.attachments:
        attachments[SNAPSHOT] = recording.attachments[SNAPSHOT]
    with RecordingWriter(output, metadata, attachments) as writer:
        yield writer.write


@contextmanager
def _table_sink(path: Path, wanted: str) -> Iterator[Sink]:
    part = path.with_name(f".{path.name}.part-{os.getpid()}")
    try:
        with part.open("w", newline="") as stream:
            rows = csv.writer(stream, lineterminator="\n")
            rows.writerow(COLUMNS)

            def receive(topic: str, record: Recorded) -> None:
                if topic == wanted and isinstance(record, Estimate):
                    rows.writerow(_row(record))

            yield receive
        part.replace(path)
    except OSError as error:
        raise failed("write", path, error) from error
    finally:
        with suppress(OSError):
            part.unlink()


def _row(estimate: Estimate) -> tuple[object, ...]:
    return (
        f"{estimate.t_ns // 1_000_000_000}.{estimate.t_ns % 1_000_000_000:09d}",
        f"{estimate.displacement_m * 1e3:.6f}",
        f"{estimate.sigma_m * 1e3:.6f}",
        f"{estimate.velocity_m_s * 1e3:.6f}",
        f"{estimate.velocity_sigma_m_s * 1e3:.6f}",
        estimate.segment,
        estimate.tier,
        estimate.can_state,
    )
