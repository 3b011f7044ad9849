"""Entries for the journal as systemd's native protocol wants them, read by a parser of its own."""

from __future__ import annotations

import logging
import os
import socket
import struct
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.logs import configure_logging
from daemon.service import journal
from daemon.service.journal import JournalHandler


def parsed(data: bytes) -> dict[str, str]:
    """NAME=VALUE lines, or NAME, length in 8 bytes, VALUE."""
    fields: dict[str, str] = {}
    while data:
        line, _, rest = data.partition(b"\n")
        name, equals, value = line.partition(b"=")
        if equals:
            data = rest
        else:
            (length,) = struct.unpack("<Q", rest[:8])
            value, data = rest[8 : 8 + length], rest[8 + length :]
            assert data[:1] == b"\n"
            data = data[1:]
        fields[name.decode()] = value.decode()
    return fields


class Journal:
    def __init__(self, folder: Path) -> None:
        self.path = folder / "socket"
        self.channel = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.channel.bind(str(self.path))
        self.channel.settimeout(5.0)

    def entry(self) -> dict[str, str]:
        return parsed(self.channel.recv(1_000_000))


@pytest.fixture
def taken(short_path: Path) -> Journal:
    return Journal(short_path)


def line(text: str, level: int = logging.WARNING, **fields: object) -> logging.LogRecord:
    made = logging.LogRecord("daemon.service.health", level, "", 0, text, None, None)
    if fields:
        made.fields = fields
    return made


def test_an_entry_has_what_the_line_is_about(taken: Journal) -> None:
    JournalHandler(str(taken.path)).emit(line("imu: samples are all ones; check CS", part="imu", state="ill"))
    entry = taken.entry()
    assert entry["MESSAGE"] == "imu: samples are all ones; check CS"
    assert (entry["PRIORITY"], entry["SYSLOG_IDENTIFIER"], entry["LOGGER"]) == (
        "4",
        "ramstroke",
        "daemon.service.health",
    )
    assert (entry["RAMSTROKE_PART"], entry["RAMSTROKE_STATE"]) == ("imu", "ill")


@given(st.text(alphabet=st.characters(exclude_categories=["Cs"]), max_size=200))
def test_any_text_is_one_entry_and_comes_back(text: str) -> None:
    encoded = journal._encoded("MESSAGE", text) + journal._encoded("PRIORITY", "6")
    assert parsed(encoded) == {"MESSAGE": text, "PRIORITY": "6"}


@pytest.mark.parametrize(
    ("level", "priority"), [(logging.DEBUG, "7"), (logging.INFO, "6"), (logging.ERROR, "3"), (logging.CRITICAL, "2")]
)
def test_levels_are_those_of_syslog(taken: Journal, level: int, priority: str) -> None:
    JournalHandler(str(taken.path)).emit(line("x", level))
    assert taken.entry()["PRIORITY"] == priority


def test_without_a_journal_the_line_goes_to_standard_error(
    short_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    JournalHandler(str(short_path / "nobody")).emit(line("still said"))
    assert "WARNING daemon.service.health: still said" in capsys.readouterr().err


def test_the_journal_is_used_only_where_standard_error_is_its_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    read, write = os.pipe()
    with os.fdopen(write, "w") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        status = os.fstat(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino}")
        assert journal.is_ours()
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino + 1}")
        assert not journal.is_ours()  # inherited, but redirected since
        monkeypatch.delenv("JOURNAL_STREAM")
        assert not journal.is_ours()
    os.close(read)


def test_logging_goes_there(monkeypatch: pytest.MonkeyPatch, taken: Journal) -> None:
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    root.handlers.clear()
    monkeypatch.setattr(journal, "is_ours", lambda: True)
    monkeypatch.setattr(JournalHandler.__init__, "__defaults__", (str(taken.path),))
    try:
        configure_logging(verbose=False)
        logging.getLogger("drivers").info("one line")
        assert taken.entry()["MESSAGE"] == "one line"
    finally:
        root.handlers[:] = handlers
        root.setLevel(level)
