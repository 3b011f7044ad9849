"""What systemd/install.sh refuses, in one sentence, before it has changed anything; `make acceptance` installs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "systemd" / "install.sh"
OLD = """#!/bin/sh
[ "$1" != --version ] || echo "Python 3.9.2"
exit 1
"""
# As Debian's without python3-venv: it is new enough, and that is all.
BARE = """#!/bin/sh
case "$2" in
    *version_info*) exit 0 ;;
    *) exit 1 ;;
esac
"""


@pytest.fixture
def computer(tmp_path: Path) -> Path:
    """A folder with a wheel and with programs that stand before the real ones."""
    (tmp_path / "ramstroke-0.1.0-py3-none-any.whl").write_text("")
    (tmp_path / "bin").mkdir()
    program(tmp_path, "id", "#!/bin/sh\necho 0\n")
    program(tmp_path, "python3", f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    return tmp_path


def program(computer: Path, name: str, text: str) -> None:
    path = computer / "bin" / name
    path.write_text(text)
    path.chmod(0o755)


def refused(computer: Path, *words: str, **variables: str) -> str:
    """The sentence."""
    environment = os.environ | {"PATH": f"{computer / 'bin'}:{os.environ['PATH']}", "PREFIX": str(computer / "opt")}
    ended = subprocess.run(
        ["sh", str(SCRIPT), *words],
        cwd=computer,
        env=environment | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr.startswith("install.sh: ")
    assert ended.stderr.count("\n") == 1
    return ended.stderr


OF_DEVELOPERS = {"hardware", "dev", "bench"}  # the first is always installed
WHEEL = "ramstroke-0.1.0-py3-none-any.whl"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "name one wheel"),
        (["--offline"], "name one wheel"),
        ([WHEEL, "another.whl"], "name one wheel"),
        (["--with", "view"], "name one wheel"),
        (["--with"], "--with needs names, separated by commas, of view,"),
        (["--with", "view,", WHEEL], "--with needs names"),
        (["--with", "view foxglove", WHEEL], "--with needs names"),
        (["--with", "*", WHEEL], "--with needs names"),
        (["--without", WHEEL], "--without is unknown; there are --offline and --with"),
        (["--with", "moon", WHEEL], "--with moon is unknown; there are view,"),
        (["--offline", "--with", "view,moon", WHEEL], "--with moon is unknown; there are view,"),
        (["--with", WHEEL], "--with needs names"),
        (["ramstroke-0.2.0-py3-none-any.whl"], "there is no file ramstroke-0.2.0-py3-none-any.whl"),
        (["bin/python3"], "bin/python3 is not a wheel of ramstroke"),
    ],
)
def test_a_wheel_must_be_named_and_options_be_known(computer: Path, words: list[str], sentence: str) -> None:
    assert sentence in refused(computer, *words)
    assert not (computer / "opt").exists()


def test_options_are_the_packages_extras() -> None:
    extras = tomllib.loads((SCRIPT.parents[1] / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(re.findall(r"known=(\S+)", SCRIPT.read_text())[0].split(",")) == extras.keys() - OF_DEVELOPERS


def test_only_root_may(computer: Path) -> None:
    program(computer, "id", "#!/bin/sh\necho 1000\n")
    assert f"needs root: sudo sh install.sh {WHEEL}" in refused(computer, WHEEL)


def test_python_must_be_there_new_enough_and_able_to_make_environments(computer: Path) -> None:
    assert "there is no python3.99 here" in refused(computer, WHEEL, PYTHON="python3.99")
    program(computer, "python3", OLD)
    assert "Python 3.9.2 is too old, 3.11 is needed" in refused(computer, WHEEL)
    program(computer, "python3", BARE)
    assert "sudo apt install python3-venv" in refused(computer, WHEEL)
    assert not (computer / "opt").exists()


def test_a_folder_of_somebody_else_stays(computer: Path) -> None:
    (computer / "opt").mkdir()
    (computer / "opt" / "precious").write_text("x")
    assert "no environment of Python: move it away" in refused(computer, WHEEL)
    assert (computer / "opt" / "precious").exists()


def test_an_environment_that_fails_half_way_is_not_left(computer: Path) -> None:
    half = '#!/bin/sh\ncase "$*" in *venv\\ --clear*) mkdir -p "$PREFIX/bin"; exit 1 ;; esac\nexit 0\n'
    program(computer, "python3", half)
    assert "nothing was installed" in refused(computer, "--offline", WHEEL)
    assert not (computer / "opt").exists()
