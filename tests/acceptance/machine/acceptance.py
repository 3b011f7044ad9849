"""`make acceptance`: builds the machine, starts it once for each group of tests, and says what came of it."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from itertools import takewhile
from pathlib import Path

from tests.acceptance.machine.build import Built, build, build_next_version
from tests.acceptance.machine.host_replay import TOLERANCE_MM, largest_difference_mm
from tests.acceptance.machine.machine import Outcome, overlay, run_in_machine
from tests.acceptance.machine.root import CHECKOUT, HERE
from tests.acceptance.machine.tools import MachineError

# Each test file in a start of the machine; those of one group see the same disk.
GROUPS = {
    "by_the_book": ("by_the_book",),  # the longest first
    "doctor": ("doctor",),
    "service": ("service_failures",),
    "trial": ("trial",),
    "power_cut": ("power_cut", "after_power_cut"),
    "sensor": ("sensor_failures",),
    "main_path": ("main_path",),
    "installation": ("installation",),
    "live_page": ("live_page",),
    "controller": ("can_controller",),
    "bus": ("bus_failures",),
}
TIMEOUT_S = 1200.0
# A second start finds this much later on its clock than the first did.
POWER_OFF_UNTIL = timedelta(seconds=60)
_SHOWN_LINES = 150  # of the journal, if something failed

_COMMAND = (
    "exec {python} -m pytest -c tests/acceptance/machine/guest/pytest.ini --rootdir=/share "
    "-p no:cacheprovider --junitxml=/share/results/junit.xml {options}{target}\n"
)
_PYTHON = "/opt/ramstroke/bin/python"
# Each test there needs the one before.
_STEPS = ("by_the_book", "trial")
# Of a computer that has never seen the program: the tests take their own Python away with them.
_ON_A_CLEAN_MACHINE = ("by_the_book",)
_MOVED_PYTHON = "/opt/tests/bin/python"


def prepare_share(share: Path, name: str) -> None:
    """What the machine sees of the checkout: tests, documents, units, bus layouts, but not the program."""
    shutil.copytree(HERE / "guest", share / "tests/acceptance/machine/guest")
    shutil.copy(HERE / "support.py", share / "tests/acceptance/machine")
    shutil.copytree(CHECKOUT / "systemd", share / "systemd")
    shutil.copytree(CHECKOUT / "config" / "dbc", share / "config" / "dbc")
    (share / "docs").mkdir()
    shutil.copy(CHECKOUT / "docs" / "installation.md", share / "docs")
    (share / "results").mkdir()
    is_clean = name in _ON_A_CLEAN_MACHINE
    command = _COMMAND.format(
        python=_MOVED_PYTHON if is_clean else _PYTHON,
        options="--exitfirst " if name in _STEPS else "",
        target=f"tests/acceptance/machine/guest/test_{name}.py",
    )
    (share / "command").write_text(f"mv /opt/ramstroke /opt/tests\n{command}" if is_clean else command)


def add_wheels(share: Path, built: Built) -> None:
    """Program and all it needs, as gathered for a computer without network; and the program's next version."""
    dist = share / "dist"
    shutil.copytree(built.wheels, dist)
    shutil.copy(built.wheel, dist)
    (share / "next").mkdir()
    build_next_version(share / "next")


def run_group(built: Built, group: str, folder: Path) -> list[str]:
    """Run the group's test files, each in a start of the machine; returns those that failed."""
    failed = []
    with tempfile.TemporaryDirectory(prefix="ramstroke-disk-") as scratch:
        files = GROUPS[group]
        disk = overlay(built, Path(scratch) / "disk.qcow2") if len(files) > 1 else None
        began = datetime.now(UTC)
        for number, name in enumerate(files):
            share = folder / name
            shutil.rmtree(share, ignore_errors=True)
            share.mkdir(parents=True)
            prepare_share(share, name)
            if name in _ON_A_CLEAN_MACHINE:
                add_wheels(share, built)
            started = began + number * POWER_OFF_UNTIL
            outcome = run_in_machine(built, share, TIMEOUT_S, disk, started, leaps=name not in _ON_A_CLEAN_MACHINE)
            _report(name, outcome)
            if outcome.code != 0:
                failed.append(name)
    if group == "main_path" and not failed:
        (recording,) = (folder / group / "results").glob("*.mcap")
        difference_mm = largest_difference_mm(recording)
        print(f"replayed here: at most {difference_mm:.2g} mm beside the machine, {TOLERANCE_MM:g} mm allowed")
        if difference_mm > TOLERANCE_MM:
            failed.append("replay on the host")
    return failed


def main() -> int:
    """0 if every test of every group passed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "groups", nargs="*", default=list(GROUPS), metavar="GROUP", help=f"of {', '.join(GROUPS)}; default: all"
    )
    parser.add_argument("--results", type=Path, help="folder that keeps journals, recordings and reports")
    arguments = parser.parse_args()
    began_s = time.monotonic()
    try:
        built = build()
        print(f"machine built or found in {time.monotonic() - began_s:.0f} s", flush=True)
        failed = []
        with tempfile.TemporaryDirectory(prefix="ramstroke-machine-") as scratch:
            folder = arguments.results or Path(scratch)
            # Each machine has one processor and keeps one of the host's busy.
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                for names in pool.map(lambda group: run_group(built, group, folder), arguments.groups):
                    failed += names
            for group in arguments.groups:
                for name in GROUPS[group]:
                    _tell_failures(folder / name / "results" / "failures.jsonl")
                    _tell_doctor(folder / name / "results" / "doctor.jsonl")
    except MachineError as error:
        print(f"acceptance machine: {error}", file=sys.stderr)
        return 1
    print(f"acceptance: {', '.join(failed) or 'nothing'} failed, {time.monotonic() - began_s:.0f} s in all")
    return 1 if failed else 0


def _tell_failures(path: Path) -> None:
    """The table of failures: what each test noted."""
    for line in path.read_text().splitlines() if path.exists() else ():
        row = json.loads(line)
        after = "" if row["good_after_s"] is None else f": good data after {row['good_after_s']:.1f} s"
        print(f"{row['failure']}{after}")
        print("".join(f"    {said}\n" for said in row["journal"]), end="")


def _tell_doctor(path: Path) -> None:
    """What doctor wants mended on each set-up."""
    for line in path.read_text().splitlines() if path.exists() else ():
        row = json.loads(line)
        print(f"doctor, {row['set_up']}: exit code {row['code']}")
        mend = list(takewhile(lambda said: said != "Better:", row["to_do"]))
        print("".join(f"    {said}\n" for said in mend), end="")


def _report(group: str, outcome: Outcome) -> None:
    print(f"--- {group}, {outcome.duration_s:.0f} s\n{outcome.output}", flush=True)
    if outcome.code != 0:
        how = outcome.ending if outcome.code is None else f"exit code {outcome.code}"
        journal = "\n".join(outcome.journal.splitlines()[-_SHOWN_LINES:])
        print(f"--- {group}: {how}; end of the machine's journal:\n{journal}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
