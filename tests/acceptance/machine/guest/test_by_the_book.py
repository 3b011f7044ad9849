"""docs/installation.md from top to bottom on a computer that has never seen the program: its commands alone."""

from __future__ import annotations

import json
import shutil
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.acceptance.machine.guest.documented import attempt, documented
from tests.acceptance.machine.guest.kit import (
    CONFIG,
    HERE,
    RECORDINGS,
    RESULTS,
    SHARE,
    Journal,
    allow_slowness,
    load_devices,
    properties,
    run,
    start_support,
    status,
    wait_for,
    write_config,
)

DIST = SHARE / "dist"
(WHEEL,) = DIST.glob("ramstroke-*.whl")
(NEXT_WHEEL,) = (SHARE / "next").glob("ramstroke-*.whl")
VERSION, NEXT_VERSION = (wheel.name.split("-")[1] for wheel in (WHEEL, NEXT_WHEEL))
INSTALL = f"sudo sh systemd/install.sh --offline dist/ramstroke-{VERSION}-py3-none-any.whl"
WITH_VIEW = f"sudo sh systemd/install.sh --with view dist/ramstroke-{VERSION}-py3-none-any.whl"
NEXT = {f"dist/{WHEEL.name}": f"next/{NEXT_WHEEL.name}"}
PROGRAM = Path("/opt/ramstroke")
STATE = Path("/var/lib/ramstroke/state.json")
SUPPORT = Path("/run/support.toml")

FOLDERS = ("/etc", "/opt", "/root", "/usr/local", "/var/lib")
NOT_OF_THE_PROGRAM = ("/opt/tests", "/var/lib/machine-support", "/var/lib/systemd", "/var/lib/private")


def listing() -> set[str]:
    """All that an installation could leave."""
    paths = {str(path) for folder in FOLDERS for path in Path(folder).rglob("*")}
    paths |= {str(path) for path in Path("/run").iterdir() if "ramstroke" in path.name}
    return {path for path in paths if not path.startswith(NOT_OF_THE_PROGRAM)}


BEFORE = listing()


@contextmanager
def timed(what: str) -> Iterator[None]:
    """Note the machine's seconds for the report; nobody judges them."""
    start_s = time.monotonic()
    yield
    RESULTS.mkdir(exist_ok=True)
    with (RESULTS / "seconds.jsonl").open("a") as file:
        file.write(json.dumps({"what": what, "seconds": round(time.monotonic() - start_s, 1)}) + "\n")


def is_refused(changes: dict[str, str] | None = None) -> str:
    """The sentence of an installation that must not happen."""
    ended = attempt(INSTALL, changes)
    assert ended.returncode == 2
    assert ended.stderr.startswith("install.sh: ")
    assert ended.stderr.count("\n") == 1
    return ended.stderr


@contextmanager
def away(path: Path) -> Iterator[None]:
    """It is missing meanwhile."""
    elsewhere = path.with_name(f"{path.name}.away")
    path.rename(elsewhere)
    yield
    elsewhere.rename(path)


def test_the_computer_is_clean() -> None:
    assert not PROGRAM.exists()
    assert not CONFIG.parent.exists()
    assert "ramstroke" not in Path("/etc/passwd").read_text()
    assert properties("LoadState") == {"LoadState": "not-found"}


def test_without_python3_venv_nothing_is_begun() -> None:
    with away(Path("/usr/lib/python3.11/ensurepip")):
        assert "sudo apt install python3-venv" in is_refused()
    assert not PROGRAM.exists()


def test_a_package_that_is_missing_is_named_and_nothing_is_left() -> None:
    (wheel,) = DIST.glob("zstandard-*.whl")
    with timed("refused installation"), away(wheel):
        assert "No matching distribution found for zstandard" in is_refused()
    assert listing() == BEFORE


def test_section_2_the_program_is_installed() -> None:
    with timed("installation"):
        said = documented(INSTALL)
    assert "look through /etc/ramstroke/ramstroke.toml" in said
    assert documented("ramstroke --version").split() == ["ramstroke", VERSION]
    assert properties("ActiveState", "UnitFileState") == {"ActiveState": "inactive", "UnitFileState": "disabled"}
    (RESULTS / "size.txt").write_text(run("du", "-sm", PROGRAM))


def test_section_4_the_bus_comes_up() -> None:
    documented("sudo cp systemd/80-can0.network /etc/systemd/network/")
    documented("sudo systemctl enable --now systemd-networkd")
    wait_for("can0 is up", lambda: "UP" in run("ip", "-brief", "link", "show", "can0").split("<")[-1])


def test_section_5_somebody_joins_the_group() -> None:
    run("useradd", "miner")
    documented('sudo usermod -aG ramstroke "$USER"', {'"$USER"': "miner"})
    assert "ramstroke" in run("id", "-Gn", "miner").split()


def test_section_6_the_configuration_is_good() -> None:
    CONFIG.write_text((HERE / "ramstroke.toml").read_text().replace("vcan0", "can0"))
    assert documented("ramstroke check-config /etc/ramstroke/ramstroke.toml").endswith("good\n")


def test_section_7_the_service_starts() -> None:
    load_devices()
    allow_slowness()
    # The controller's end of the bus.
    run("ip", "link", "set", "can1", "up", "type", "can", "bitrate", "250000")
    write_config(SUPPORT, "can1")
    start_support(SUPPORT)
    with timed("start"):
        assert "started" in documented("sudo ramstroke install-service --start")
    assert properties("ActiveState", "UnitFileState") == {"ActiveState": "active", "UnitFileState": "enabled"}
    assert documented("candump -n 10 can0").count("can0") == 10


def test_section_8_it_runs_and_learns_from_a_push() -> None:
    documented("systemctl status ramstroke")
    said = documented("ramstroke status")
    assert f"ramstroke {VERSION}" in said
    wait_for("something learned", lambda: pushes_learned_from() == 1)


def pushes_learned_from() -> int:
    learned = status().get("learned")
    return int(learned["push"]["moves"]) if learned else 0


def test_section_8_doctor_beside_a_daemon_finds_no_fault_of_the_installation() -> None:
    ended = attempt("sudo -u ramstroke ramstroke doctor")
    (RESULTS / "doctor.txt").write_text(ended.stdout + ended.stderr)
    assert ended.returncode in (0, 1)  # an emulated machine is slow enough to be called ill
    assert "user ramstroke may use /dev/spidev0.0 and /dev/gpiochip0" in " ".join(ended.stdout.split())


def test_a_foreign_file_under_a_wheels_name_leaves_what_runs() -> None:
    before = properties("MainPID")
    broken = SHARE / "next" / "ramstroke-0.9.9-py3-none-any.whl"
    broken.write_text("no wheel")
    assert "nothing was changed" in is_refused({f"dist/{WHEEL.name}": f"next/{broken.name}"})
    shutil.copy(next(DIST.glob("pyserial-*.whl")), broken)
    assert "nothing was changed" in is_refused({f"dist/{WHEEL.name}": f"next/{broken.name}"})
    assert documented("ramstroke --version").split() == ["ramstroke", VERSION]
    assert properties("MainPID") == before


def test_an_upgrade_starts_the_service_anew_and_keeps_all_else() -> None:
    configuration, recordings = CONFIG.read_bytes(), set(RECORDINGS.glob("*.mcap"))
    old = properties("MainPID")
    journal = Journal()
    with timed("upgrade, with the restart"):
        documented(INSTALL, NEXT)
    assert documented("ramstroke --version").split() == ["ramstroke", NEXT_VERSION]
    assert properties("ActiveState", "UnitFileState") == {"ActiveState": "active", "UnitFileState": "enabled"}
    assert properties("MainPID") != old
    journal.wait_for(f"ramstroke {NEXT_VERSION} runs")
    journal.close()
    assert CONFIG.read_bytes() == configuration
    assert recordings < set(RECORDINGS.glob("*.mcap"))
    assert wait_for("what was learned", pushes_learned_from) == 1


def test_the_way_back_to_the_older_version() -> None:
    run("systemctl", "stop", "ramstroke")
    with timed("downgrade"):
        documented(INSTALL)
    assert documented("ramstroke --version").split() == ["ramstroke", VERSION]
    assert properties("ActiveState") == {"ActiveState": "inactive"}  # as before


def test_removal_leaves_what_the_document_says_and_nothing_else() -> None:
    override = Path("/etc/systemd/system/ramstroke.service.d/override.conf")
    override.write_text("[Service]\nNice=-1\n")  # by systemctl edit
    state, recordings = STATE.read_bytes(), set(RECORDINGS.glob("*.mcap"))
    documented("sudo ramstroke remove-service")
    documented("sudo rm -r /opt/ramstroke")
    left = listing() - BEFORE
    (RESULTS / "left.txt").write_text("".join(f"{path}\n" for path in sorted(left)))
    kept = {str(path) for path in (CONFIG.parent, CONFIG, STATE.parent, STATE, RECORDINGS, *recordings)}
    kept |= {str(path) for path in (override.parent, override, override.with_name("slow-machine.conf"))}
    assert {path for path in left - kept if not is_of_the_computer(path)} == set()
    assert kept <= left
    assert STATE.read_bytes() == state
    assert properties("LoadState") == {"LoadState": "not-found"}


def attempt_page() -> bytes:
    try:
        with urllib.request.urlopen("http://127.0.0.1:8448/", timeout=60) as answer:
            return b"<main>" if b"<main>" in answer.read() else b"something else"
    except OSError:
        return b""


def is_of_the_computer(path: str) -> bool:
    """The bus of section 4 and the user of section 5: what systemd and useradd made of them."""
    of_bus = path.startswith("/etc/systemd/") and ("network" in path or path.endswith(".wants"))
    return of_bus or path in ("/etc/subgid-", "/etc/subuid-")


def test_section_11_a_second_installation_has_the_page_and_takes_up_what_was_learned() -> None:
    documented(WITH_VIEW, {"--with": "--offline --with"})
    documented("sudo systemctl enable --now ramstroke-view")
    wait_for("the page", lambda: attempt_page() == b"<main>")
    documented("sudo ramstroke install-service --start")
    assert wait_for("what was learned", pushes_learned_from) == 1


def test_a_purge_leaves_nothing_but_the_user() -> None:
    documented("sudo ramstroke remove-service --purge")
    documented("sudo rm -r /opt/ramstroke")
    assert {path for path in listing() - BEFORE if not is_of_the_computer(path)} == set()
    assert run("id", "-un", "ramstroke").strip() == "ramstroke"
    run("gpasswd", "--delete", "miner", "ramstroke")
    run("userdel", "ramstroke")
    assert "ramstroke" not in Path("/etc/passwd").read_text() + Path("/etc/group").read_text()
