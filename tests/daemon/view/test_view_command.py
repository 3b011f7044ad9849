"""`ramstroke view` as a program, and its unit."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from daemon.cli import main
from daemon.service.installer import shipped
from daemon.service.live import LINES_PER_VIEWER, WRITE_BUFFER_BYTES
from tests.daemon.view.view_kit import daemon_at, free_port, wait_until

PATIENCE_S = 60.0


def config_in(folder: Path) -> Path:
    path = folder / "view.toml"
    path.write_text(
        f'[recording]\ndirectory = "{folder}/recordings"\n'
        f'[service]\nsocket = "{folder}/live"\nstate_file = "{folder}/state.json"\n'
    )
    return path


@contextmanager
def started(folder: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The program, and the first line that it printed."""
    command = [sys.executable, "-m", "daemon.cli", "view", "--config", str(config_in(folder)), *options]
    scratch = folder / "scratch"
    scratch.mkdir(exist_ok=True)
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TMPDIR": str(scratch)},
    )
    try:
        assert process.stdout is not None
        yield process, process.stdout.readline()
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def rss_kb(pid: int) -> int:
    (line,) = (line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1])


def listening_on(port: int) -> set[str]:
    """Local addresses (hexadecimal) on which somebody listens, by the kernel's own table."""
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return {row[1].split(":")[0] for row in rows if row[3] == "0A" and int(row[1].split(":")[1], 16) == port}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_serves_loopback_only_and_ends_cleanly(short_path: Path, number: signal.Signals) -> None:
    port = free_port()
    with started(short_path, "--port", str(port)) as (process, said):
        assert said == f"the live page: http://127.0.0.1:{port}/\n"
        assert listening_on(port) == {"0100007F"}
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=10) as page:
            assert b"<main>" in page.read()
        assert list((short_path / "scratch").iterdir())  # where its reports would be made
        process.send_signal(number)
        out, error = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, out, error) == (0, "", "")
    assert not list((short_path / "scratch").iterdir())


def test_beyond_loopback_an_address_with_a_token_is_printed_and_needed(short_path: Path) -> None:
    port = free_port()
    with started(short_path, "--port", str(port), "--listen", "0.0.0.0") as (_, said):
        found = re.fullmatch(
            rf"the live page: http://{re.escape(socket.gethostname())}:{port}/\?token=([\w-]{{32}})\n", said
        )
        assert found is not None
        with pytest.raises(urllib.error.HTTPError, match="401"):
            urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=10)
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/?token={found[1]}", timeout=10) as page:
            assert "HttpOnly" in page.headers["Set-Cookie"]


def test_a_token_of_ones_own_holds_and_is_not_printed(short_path: Path) -> None:
    port, token = free_port(), short_path / "token"
    token.write_text("0123456789abcdef\n")
    token.chmod(0o600)
    with started(short_path, "--port", str(port), "--token-file", str(token)) as (_, said):
        assert said == f"the live page: http://127.0.0.1:{port}/\n"
        with pytest.raises(urllib.error.HTTPError, match="401"):
            urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=10)
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/?token=0123456789abcdef", timeout=10) as page:
            assert page.status == 200


@pytest.mark.parametrize(
    ("content", "mode", "why"),
    [
        (None, 0o600, "cannot be read"),
        ("short", 0o600, "at least 16"),
        ("0123456789abcde f", 0o600, "at least 16"),
        ("0123456789äöü0123", 0o600, "plain letters"),
        ("0123456789abcdef", 0o644, "chmod o="),
    ],
)
def test_a_bad_token_file_is_refused_in_one_sentence(
    short_path: Path, content: str | None, mode: int, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = short_path / "token"
    if content is not None:
        path.write_text(content)
        path.chmod(mode)
    assert main(["view", "--config", str(config_in(short_path)), "--token-file", str(path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"ramstroke: --token-file {path}")
    assert why in said
    assert said.count("\n") == 1


def test_a_port_that_is_taken_and_an_address_of_others_are_named(short_path: Path) -> None:
    config = str(config_in(short_path))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        for listen in ("127.0.0.1", "192.0.2.1"):
            command = [sys.executable, "-m", "daemon.cli", "view", "--config", config, "--port", str(port)]
            done = subprocess.run([*command, "--listen", listen], capture_output=True, text=True, timeout=PATIENCE_S)
            assert done.returncode == 1
            assert done.stderr.startswith(f"ramstroke: cannot listen on {listen} port {port} (")
            assert (done.stdout, done.stderr.count("\n")) == ("", 1)


@pytest.mark.parametrize("port", ["0", "65536", "x"])
def test_a_port_that_is_none_is_wrong_usage(port: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "--port", port]) == 2
    assert "--port" in capsys.readouterr().err


def test_a_missing_extra_is_told_in_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    assert main(["view"]) == 1
    assert capsys.readouterr().err == (
        "ramstroke: the live page needs aiohttp: `systemd/install.sh --with view WHEEL` as root, "
        'or `pip install ".[view]"` in the sources\n'
    )


def test_neither_a_daemon_in_full_spate_nor_a_deaf_browser_makes_it_grow(short_path: Path) -> None:
    from tests.daemon.view.test_view_link import deaf_browser_at

    port = free_port()
    with daemon_at(short_path / "live") as daemon, started(short_path, "--port", str(port)) as (process, _):
        daemon.start(talk=False)
        wait_until(lambda: daemon.viewers == 1)
        with deaf_browser_at(port):
            sizes = []
            for _ in range(4):
                for _ in range(1000):  # 10 MB each time, a thousand times what is kept
                    daemon.push("event", {"t_s": 0.0, "what": "x" * 10_000})
                wait_until(lambda: daemon._server is not None and not any(v._lines for v in daemon._server._viewers))
                sizes.append(rss_kb(process.pid))
        assert sizes[-1] - sizes[0] < 3000, sizes


def test_a_view_that_stands_still_costs_the_daemon_no_memory_and_goes_on_later(short_path: Path) -> None:
    with daemon_at(short_path / "live") as daemon, started(short_path, "--port", str(free_port())) as (process, _):
        daemon.start(talk=False)
        wait_until(lambda: daemon.viewers == 1)
        assert daemon._server is not None
        (viewer,) = daemon._server._viewers
        process.send_signal(signal.SIGSTOP)
        for _ in range(2000):
            daemon.push("event", {"t_s": 0.0, "what": "x" * 10_000})
        assert len(viewer._lines) == LINES_PER_VIEWER
        assert viewer._writer.transport.get_write_buffer_size() < WRITE_BUFFER_BYTES + 2 * 10_100
        assert daemon._server.dropped > 1500
        process.send_signal(signal.SIGCONT)
        wait_until(lambda: not viewer._lines)
        assert daemon.viewers == 1


def test_a_socket_that_may_not_be_read_is_told(short_path: Path) -> None:
    """To an ordinary user: the superuser, as in a container, may read all."""
    port = free_port()
    program = (
        # Before the right to read them is gone.
        "import os, sys, signal, tempfile, importlib.metadata, encodings.utf_8_sig, encodings.cp1252, aiohttp.web\n"
        "import daemon.cli, daemon.commands.view\n"
        "import daemon.recording.metadata, daemon.settings, daemon.view.server, daemon.view.token\n"
        "if os.geteuid() == 0: os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
        "from daemon.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    with daemon_at(short_path / "live") as daemon:
        daemon.start()
        (short_path / "live").chmod(0o000)
        short_path.chmod(0o755)
        command = [sys.executable, "-c", program, "view", "--config", str(config_in(short_path)), "--port", str(port)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            assert process.stderr.readline() == (
                f"ramstroke: no right to read {short_path}/live: `sudo usermod -aG ramstroke $USER`, then log in anew\n"
            )
            process.terminate()
            process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0
    short_path.chmod(0o700)


def test_the_unit_is_hardened_loopback_and_apart_from_the_daemon() -> None:
    text = shipped("ramstroke-view.service")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    options = dict(line.split("=", 1) for line in lines if "=" in line)
    assert options["ExecStart"] == "/opt/ramstroke/bin/ramstroke view --config /etc/ramstroke/ramstroke.toml"
    assert options["RestrictAddressFamilies"] == "AF_INET AF_INET6 AF_UNIX"
    assert (options["DynamicUser"], options["SupplementaryGroups"]) == ("yes", "ramstroke")
    for name in (
        "NoNewPrivileges",
        "ProtectHome",
        "PrivateTmp",
        "PrivateDevices",
        "MemoryDenyWriteExecute",
        "RestrictNamespaces",
    ):
        assert options[name] == "yes"
    assert (options["ProtectSystem"], options["CapabilityBoundingSet"]) == ("strict", "")
    daemon = shipped("ramstroke.service")
    assert "AF_INET" not in daemon
    assert "ramstroke-view" not in daemon
