"""What a replay can write: a recording, a table of steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from daemon.offline.replay import ReplayResult, replay
from daemon.offline.step_table import COLUMNS, cells, step_table
from daemon.recording import topics
from daemon.recording.errors import refuse_same_file
from daemon.recording.metadata import LEARNED, SNAPSHOT
from daemon.recording.reader import Recording
from daemon.recording.topics import Recorded
from daemon.recording.writer import RecordingWriter
from daemon.settings import Settings
from daemon.stream import Sink
from estimation.records import Estimate


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
    with step_table(path, COLUMNS) as add_row:

        def receive(topic: str, record: Recorded) -> None:
            if topic == wanted and isinstance(record, Estimate):
                add_row(cells(record))

        yield receive
