"""A push and a retract through the kernel's interfaces: sensor and bus, estimator, recording, bus."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools.database
import pytest
from cantools.database.can import Database

import daemon
from tests.acceptance.machine.guest.kit import (
    CONFIG,
    HERE,
    RAMSTROKE,
    RECORDINGS,
    RESULTS,
    SHARE,
    Journal,
    account,
    keep,
    properties,
    run,
    set_up,
    start_service,
    status,
)

STROKE_MM = 500.0
CYCLE_S = 100.0  # of the virtual support: push from 10 to 44 s, retract from 65 to 78 s


@dataclass
class Cycle:
    """What is left of one push and retract."""

    ready: dict[str, str]  # systemd's words when the start returned
    status: dict[str, Any]
    said: str  # by `ramstroke status`
    journal: list[str]
    dump: Path  # candump's
    recording: Path
    account: dict[str, int]
    replayed: dict[str, Any]
    result: dict[str, str]


@pytest.fixture(scope="module")
def cycle() -> Iterator[Cycle]:
    set_up()
    journal = Journal()
    dump = RESULTS / "can.log"
    RESULTS.mkdir(exist_ok=True)
    with dump.open("w") as file, subprocess.Popen(["candump", "-L", "vcan0,6F0:7FF"], stdout=file) as candump:
        start_service()
        ready = properties("ActiveState", "SubState", "StatusText", "NRestarts")
        journal.wait_for("stop confirmed (push)", CYCLE_S)
        journal.wait_for("stop confirmed (retract)", CYCLE_S)
        time.sleep(3.0)
        said, now = run(RAMSTROKE, "status"), status()
        json.loads(run(RAMSTROKE, "status", "--json"))
        counted = account()
        run("systemctl", "stop", "ramstroke")
        candump.terminate()
    (recording,) = RECORDINGS.glob("*.mcap")
    replayed = json.loads(run(RAMSTROKE, "replay", recording, "--json"))
    journal.close()
    result = properties("Result", "ExecMainStatus", "NRestarts")
    yield Cycle(ready, now, said, journal.lines(), dump, recording, counted, replayed, result)
    keep(recording)
    (RESULTS / "replayed.json").write_text(json.dumps(replayed))


def test_the_installed_program_is_tested(cycle: Cycle) -> None:
    assert str(daemon.__path__[0]).startswith("/opt/ramstroke/lib/")
    assert not (SHARE / "daemon").exists()
    assert run(RAMSTROKE, "check-config", CONFIG).strip().endswith("good")
    assert CONFIG.read_text() == (HERE / "ramstroke.toml").read_text()


def test_the_service_reports_that_it_is_ready(cycle: Cycle) -> None:
    assert cycle.ready["ActiveState"] == "active"
    assert cycle.ready["SubState"] == "running"
    assert cycle.result == {"Result": "success", "ExecMainStatus": "0", "NRestarts": "0"}


def test_every_part_is_well(cycle: Cycle) -> None:
    assert "inertial sensor: serial 1234 is running" in "\n".join(cycle.journal)
    assert cycle.status["imu"]["state"] in ("ok", "ill")  # a slow machine may miss samples
    assert {cycle.status[part]["state"] for part in ("can", "displacement", "recorder")} == {"ok"}
    assert "stroke" in cycle.said


def test_samples_come_with_the_kernels_edges(cycle: Cycle) -> None:
    counters = cycle.status["imu"]
    assert counters["edge_reads"] > 1000
    assert counters["edge_reads"] > 20 * counters["paced_reads"]
    assert counters["starts"] == 1


def test_transfers_are_such_as_the_data_sheet_allows(cycle: Cycle) -> None:
    violations = {what: count for what, count in cycle.account.items() if what.startswith("violation") and count}
    assert violations == {}
    assert cycle.account["bursts"] > 1000


def test_push_and_retract_are_measured(cycle: Cycle) -> None:
    push, retract = cycle.replayed["moves"]
    assert (push["kind"], retract["kind"]) == ("push", "retract")
    assert abs(push["end_mm"] - STROKE_MM) < 5.0
    assert abs(retract["end_mm"]) < 5.0


def test_the_recording_is_reproduced_bit_for_bit_where_it_was_made(cycle: Cycle) -> None:
    assert cycle.replayed["identical"] is True
    assert cycle.replayed["damage"] == []


def test_the_estimate_is_on_the_bus(cycle: Cycle) -> None:
    database = cantools.database.load_file(SHARE / "config" / "dbc" / "ramstroke_estimate.dbc", database_format="dbc")
    assert isinstance(database, Database)
    decoded = []
    for line in cycle.dump.read_text().splitlines():
        identifier, _, data = line.split()[2].partition("#")
        values = database.decode_message(int(identifier, 16), bytes.fromhex(data), decode_choices=False)
        assert isinstance(values, dict)
        decoded.append(values)
    assert len(decoded) > 200
    counters = [int(str(values["counter"])) for values in decoded]
    assert counters == [(counters[0] + i) % 16 for i in range(len(decoded))]
    strokes = [float(str(values["displacement"])) for values in decoded]
    assert max(strokes) == pytest.approx(STROKE_MM, abs=15.0)
    assert strokes[-1] == pytest.approx(0.0, abs=15.0)
