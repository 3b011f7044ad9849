"""What a replay can write: a recording, a table of steps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from daemon.offline.replaying.methods import replay_method
from daemon.offline.replaying.replay import Progress, ReplayResult, replay, stream_at_start
from daemon.offline.replaying.step_table import COLUMNS, cells, step_table
from daemon.recording import topics
from daemon.recording.errors import refuse_same_file
from daemon.recording.reader import Recording
from daemon.recording.topics import Recorded
from daemon.recording.writer import RecordingWriter
from daemon.service import state_file
from daemon.service.state_file import StateFileError
from daemon.settings import Settings
from daemon.stream import Sink
from estimation.methods.registry import OURS
from estimation.records import Estimate


def replay_to(
    source: Path,
    settings: Settings | None = None,
    *,
    output: Path | None = None,
    table: Path | None = None,
    provisional: bool = False,
    state: Path | None = None,
    end_state: Path | None = None,
    method: str = OURS,
    progress: Progress | None = None,
) -> ReplayResult:
    """Replay `source` and write what was asked for, each file whole or not at all.

    state, end_state: state files to start from and to write at the end; may be the same.
    method: another one than ours knows no states.

    Raises RecordingError or StateFileError.
    """
    sinks: list[Sink] = []
    with ExitStack() as stack:
        if output is not None:
            sinks.append(stack.enter_context(_recording_sink(source, output, settings, state)))
        if table is not None:
            refuse_same_file(source, table)
            wanted = topics.PROVISIONAL if provisional else topics.SETTLED
            sinks.append(stack.enter_context(_table_sink(table, wanted)))

        def receive(topic: str, record: Recorded) -> None:
            for sink in sinks:
                sink(topic, record)

        if end_state is not None and end_state.exists() and end_state.samefile(source):
            raise StateFileError(f"{end_state} is the file to read from: name another file for the state")
        if method != OURS:
            return replay_method(source, method, settings, receive, progress)
        result = replay(source, settings, receive, progress, state=state)
        if end_state is not None:
            _save_state(end_state, source, result)
        return result


def _save_state(path: Path, source: Path, result: ReplayResult) -> None:
    if result.end is None:
        raise StateFileError(f"{source} brings about no estimate: there is no state to save in {path}")
    try:
        state_file.save(path, result.end)
    except OSError as error:
        raise StateFileError(f"cannot write {path}: {error.strerror or error}") from error


@contextmanager
def _recording_sink(source: Path, output: Path, settings: Settings | None, state: Path | None) -> Iterator[Sink]:
    refuse_same_file(source, output)
    recording = Recording(source)
    metadata = dict(recording.metadata)
    if settings is not None:
        metadata["settings"] = settings.model_dump_json()
    attachments = stream_at_start(recording, settings, lambda _topic, _record: None, state).attachments()
    with RecordingWriter(output, metadata, attachments) as writer:
        yield writer.write


@contextmanager
def _table_sink(path: Path, wanted: str) -> Iterator[Sink]:
    with step_table(path, COLUMNS) as add_row:

        def receive(topic: str, record: Recorded) -> None:
            if topic == wanted and isinstance(record, Estimate):
                add_row(cells(record))

        yield receive
