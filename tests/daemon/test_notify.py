"""Words to systemd reach its socket, one datagram each, and never hinder the program."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from daemon.service.notify import Notifier


def received(channel: socket.socket) -> list[str]:
    channel.setblocking(False)
    words = []
    while True:
        try:
            words.append(channel.recv(4096).decode())
        except BlockingIOError:
            return words


def say_everything(notifier: Notifier) -> None:
    notifier.ready()
    notifier.status("312.4 ± 2.0 mm; imu running")
    notifier.watchdog()
    notifier.stopping()


EVERYTHING = ["READY=1", "STATUS=312.4 ± 2.0 mm; imu running", "WATCHDOG=1", "STOPPING=1"]


def test_every_word_arrives_as_a_datagram_of_its_own(short_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(short_path / "notify"))
        say_everything(Notifier(str(short_path / "notify")))
        assert received(systemd) == EVERYTHING


def test_an_address_with_an_at_sign_is_in_the_abstract_namespace(short_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(f"\0{short_path}")
        say_everything(Notifier(f"@{short_path}"))
        assert received(systemd) == EVERYTHING


def test_the_address_comes_from_the_environment(short_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(short_path / "notify"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(short_path / "notify"))
        say_everything(Notifier())
        assert received(systemd) == EVERYTHING


def test_without_systemd_nothing_happens(monkeypatch: pytest.MonkeyPatch, short_path: Path) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    say_everything(Notifier())
    say_everything(Notifier(str(short_path / "nobody")))


def test_a_status_of_several_lines_cannot_say_anything_else(short_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(short_path / "notify"))
        Notifier(str(short_path / "notify")).status("waiting: first\nWATCHDOG=1\n")
        assert received(systemd) == ["STATUS=waiting: first WATCHDOG=1"]


def test_a_listener_that_does_not_read_holds_nobody_up(short_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.bind(str(short_path / "notify"))
        notifier = Notifier(str(short_path / "notify"))
        for number in range(10_000):
            notifier.status(f"word {number}")
        channel.setblocking(False)
        assert channel.recv(100) == b"STATUS=word 0"


@pytest.mark.parametrize(
    ("variables", "limit_s"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "10000000"}, 10.0),
        ({"WATCHDOG_USEC": "10000000", "WATCHDOG_PID": "1"}, None),  # of another process
        ({"WATCHDOG_USEC": "ten"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
    ],
)
def test_how_long_systemd_waits_for_a_sign_of_life(
    variables: dict[str, str], limit_s: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("WATCHDOG_USEC", "WATCHDOG_PID"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert Notifier("").watchdog_s == limit_s
