"""What a replay can write: a recording, a table of steps."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from daemon.offline.replay import ReplayResult, replay, stream_at_start
from daemon.recording import topics
from daemon.recording.errors import failed, refuse_same_file
from daemon.recording.reader import Recording
from daemon.recording.topics import Recorded
from daemon.recording.writer import RecordingWriter
from daemon.service import state_file
from daemon.service.state_file import StateFileError
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
    state: Path | None = None,
    end_state: Path | None = None,
    progress: Callable[[int], None] | None = None,
) -> ReplayResult:
    """Replay `source` and write what was asked for, each file whole or not at all.

    state, end_state: state files to start from and to write at the end; may be the same.

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
        result = replay(source, settings, receive, progress, state)
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
