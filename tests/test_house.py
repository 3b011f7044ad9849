"""The house keeps its order: who may import whom, what a running daemon loads, what an installed wheel holds."""

from __future__ import annotations

import ast
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

HOUSE = Path(__file__).resolve().parents[1]
PACKAGES = ("estimation", "drivers", "daemon")
# Whole packages or single modules of ours that each may import.
MAY_IMPORT = {
    "estimation": ("estimation",),
    "drivers": ("drivers", "estimation.records"),
    "daemon": ("daemon", "drivers", "estimation"),
}
HEAVY = ("scipy", "sklearn", "pandas", "matplotlib", "asammdf", "numba", "plotly", "pyarrow", "aiohttp", "foxglove")
OFFLINE_ONLY = (*HEAVY, "rich")


def sources(package: str) -> list[Path]:
    found = sorted((HOUSE / package).rglob("*.py"))
    assert found
    return found


def imported_by(path: Path, *, on_load_only: bool = False) -> Iterator[str]:
    """Full names of what a source file imports; `from x import y` counts as x.y."""
    tree = ast.parse(path.read_text())
    for node in tree.body if on_load_only else ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def is_within(name: str, package: str) -> bool:
    return name == package or name.startswith(f"{package}.")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_imports_only_what_the_house_allows(package: str) -> None:
    trespassing = [
        f"{path.relative_to(HOUSE)}: {name}"
        for path in sources(package)
        for name in imported_by(path)
        if any(is_within(name, ours) for ours in (*PACKAGES, "tests"))
        and not any(is_within(name, allowed) for allowed in MAY_IMPORT[package])
    ]
    assert trespassing == []


@pytest.mark.parametrize("package", PACKAGES)
def test_nothing_heavy_is_imported_on_load(package: str) -> None:
    heavy = [
        f"{path.relative_to(HOUSE)}: {name}"
        for path in sources(package)
        for name in imported_by(path, on_load_only=True)
        if any(is_within(name, module) for module in HEAVY)
    ]
    assert heavy == []


def test_the_estimator_knows_no_clock_file_loop_or_device() -> None:
    outside = ("time", "asyncio", "threading", "socket", "pathlib", "os", "can", "mcap")
    found = [
        f"{path.relative_to(HOUSE)}: {name}"
        for path in sources("estimation")
        for name in imported_by(path)
        if any(is_within(name, module) for module in outside)
    ]
    assert found == []


@pytest.mark.parametrize(
    "module", ["daemon.service.application", "daemon.simulation.virtual", "daemon.simulation.server"]
)
def test_a_running_daemon_loads_nothing_heavy(module: str) -> None:
    program = f"import sys, {module}; print(*sorted(set(sys.modules) & set({OFFLINE_ONLY!r})))"
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=HOUSE, timeout=60, check=True
    )
    assert ended.stdout == "\n"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=HOUSE, capture_output=True, timeout=120, check=True)
    (built,) = folder.glob("*.whl")
    return built


def test_a_wheel_holds_the_three_packages_and_the_configuration(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as opened:
        names = set(opened.namelist())
        metadata = next(name for name in names if name.endswith("entry_points.txt"))
        assert "ramstroke = daemon.cli:main" in opened.read(metadata).decode()
    expected = {str(path.relative_to(HOUSE)) for package in PACKAGES for path in sources(package)}
    expected |= {str(path.relative_to(HOUSE)) for path in (HOUSE / "config").rglob("*.*") if path.is_file()}
    page = HOUSE / "daemon" / "offline" / "report" / "page"
    expected |= {str(path.relative_to(HOUSE)) for path in page.iterdir()}
    expected |= {str(path.relative_to(HOUSE)) for path in (HOUSE / "daemon" / "view" / "pages").iterdir()}
    assert expected <= names
    assert sum(name.startswith("config/dbc/") and name.endswith(".dbc") for name in names) >= 4
    assert not any(name.startswith("tests/") for name in names)


def test_an_installed_wheel_finds_its_dbc_files(wheel: Path, tmp_path: Path) -> None:
    """From its own place, not from the checkout's."""
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as opened:
        opened.extractall(site)
    (tmp_path / "good.toml").write_text('[can.displacement]\npreset = "j1939_proprietary_b"\n')
    program = (
        f"import sys; sys.path.insert(0, {str(site)!r})\n"
        "from daemon.cli import main; from drivers.can.presets import DBC_FOLDER; print(DBC_FOLDER)\n"
        "sys.exit(main(['check-config', 'good.toml']))"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path, timeout=60, check=True
    )
    assert ended.stdout == f"{site}/config/dbc\ngood.toml: good\n"


def test_the_readme_shows_the_terminal_as_it_was_last_pictured() -> None:
    shown = (HOUSE / "docs" / "images" / "watch.txt").read_text()
    assert "LIVE" in shown
    assert f"```\n{shown}```\n" in (HOUSE / "README.md").read_text()
