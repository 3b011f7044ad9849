"""Pictures of the live views for the documentation, with a virtual support in mid-push.

python -m tests.browser.live_pictures        # docs/images/live.png, live-phone.png and watch.txt; a minute
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from playwright.sync_api import Error, Page, expect, sync_playwright

from tests.daemon.terminal_kit import AtTerminal
from tests.daemon.view.view_kit import free_port

IMAGES = Path(__file__).parents[2] / "docs" / "images"
PUSHED_MM = 430.0  # by then the plots are full
PATIENCE_S = 180.0
SIZES = {"live.png": (1366, 768), "live-phone.png": (390, 844)}
TERMINAL = (84, 24)  # columns, lines
PROGRAM = (sys.executable, "-m", "daemon.cli")


def shoot(folder: Path) -> list[Path]:
    """Make the pictures; returns where they are."""
    processes = []
    with tempfile.TemporaryDirectory(prefix="rs-") as name:
        config, port = _config(Path(name)), free_port()
        try:
            for command in (["run"], ["view", "--port", str(port)]):
                arguments = [*PROGRAM, command[0], "--config", str(config), *command[1:]]
                processes.append(subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
            with AtTerminal([*PROGRAM, "watch", "--config", str(config)], TERMINAL) as terminal:
                made = _look(f"http://127.0.0.1:{port}/", folder, lambda: terminal.read(0.0))
                terminal.read(0.5)
                (folder / "watch.txt").write_text(terminal.shows("q quit") + "\n")
            return [*made, folder / "watch.txt"]
        finally:
            for process in reversed(processes):
                process.terminate()
                process.wait(30)


def _config(folder: Path) -> Path:
    """A quarter of the samples: browsers and support share this computer."""
    path = folder / "pictures.toml"
    path.write_text(
        f'[imu]\ntransport = "virtual"\ndecimation_exponent = 2\n[can]\ninterface = "virtual"\nchannel = "{folder}"\n'
        f'[recording]\ndirectory = "{folder}/recordings"\nkeep_free_mb = 0\n'
        f'[service]\nsocket = "{folder}/live"\nstate_file = "{folder}/state.json"\n'
        "[simulation]\nseed = 1\n"
    )
    return path


def _look(url: str, folder: Path, meanwhile: Callable[[], object]) -> list[Path]:
    made = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        pages = []
        for file, (width, height) in SIZES.items():
            page = browser.new_page(viewport={"width": width, "height": height}, locale="en-GB")
            _open(page, url)
            pages.append((file, page))
        deadline = time.monotonic() + PATIENCE_S
        first = pages[0][1]
        while not _is_pushed(first.inner_text("#stroke-number")) and time.monotonic() < deadline:
            first.wait_for_timeout(200)
            meanwhile()
        for file, page in pages:
            page.bring_to_front()
            page.wait_for_timeout(300)
            page.screenshot(path=folder / file)
            made.append(folder / file)
        browser.close()
    return made


def _open(page: Page, url: str) -> None:
    """As soon as the server listens."""
    for _ in range(100):
        try:
            page.goto(url)
            break
        except Error:
            page.wait_for_timeout(200)
    expect(page.locator("body")).to_have_attribute("data-freshness", "fresh", timeout=60_000)


def _is_pushed(words: str) -> bool:
    try:
        return float(words) > PUSHED_MM
    except ValueError:
        return False


def main() -> None:
    """Make the pictures and say where they are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=IMAGES)
    for path in shoot(parser.parse_args().out):
        print(path)


if __name__ == "__main__":
    main()
