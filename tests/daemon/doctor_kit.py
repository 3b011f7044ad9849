"""A patient on twins in simulated time, healthy unless a test harms it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from daemon.doctor import adis16448
from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, Verdict
from daemon.settings import Settings
from drivers.clock import VirtualClock
from drivers.data_ready import DataReady
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.faults import FaultScript
from drivers.virtual.faulty_line import FaultyEdges, FaultyWires
from drivers.virtual.faulty_part import PartSchedule
from drivers.virtual.inertial_input import SteadyInput
from drivers.virtual.sensor_errors import SensorErrors, SensorGrade

LONG_S = 1000.0
NO_SYSTEMD = "there is no systemd here"


def patient(folder: Path, **sections: dict[str, Any]) -> Patient:
    """Of a configuration that writes below `folder`."""
    tree: dict[str, dict[str, Any]] = {
        "imu": {"transport": "virtual"},
        "can": {"interface": "virtual", "channel": str(folder)},
        "recording": {"directory": str(folder / "recordings"), "keep_free_mb": 0},
        "service": {"socket": str(folder / "live"), "state_file": str(folder / "state.json")},
    }
    for name, values in sections.items():
        tree.setdefault(name, {}).update(values)
    return Patient(Settings.model_validate(tree), None, NO_SYSTEMD, clock=VirtualClock(), listen_s=1.0)


class Bench:
    """A part behind wires that a fault script harms from the beginning to the end."""

    def __init__(
        self,
        folder: Path,
        *faults: dict[str, Any],
        imu: dict[str, Any] | None = None,
        mount: dict[str, Any] | None = None,
        source: SteadyInput | None = None,
        grade: SensorGrade | None = None,
    ) -> None:
        self.patient = patient(folder, imu=imu or {}, mount=mount or {})
        lasting = [{"at_s": 0.0, "for_s": LONG_S, **fault} for fault in faults]
        script = FaultScript.model_validate({"fault": lasting})
        errors = SensorErrors(np.random.default_rng(1), grade)
        part = VirtualAdis16448(
            source or SteadyInput(),
            self.patient.clock,
            errors=errors,
            schedule=PartSchedule(script, 0),
            edge_wire=FaultyEdges(script, 0),
        )
        self.part = FaultyWires(part, script, 0)

    def line(self) -> DataReady:
        settings = self.patient.settings.imu
        return self.part.data_ready(pin=settings.data_ready_pin)

    def examine(self, open_line: Any = "the part's") -> dict[str, Check]:
        checks = adis16448.examine(
            self.patient, lambda: self.part, self.line if open_line == "the part's" else open_line
        )
        return by_name(checks)


def by_name(checks: list[Check]) -> dict[str, Check]:
    found = {check.name: check for check in checks}
    assert len(found) == len(checks), "two checks of one name"
    return found


def names_of(checks: dict[str, Check], verdict: Verdict) -> list[str]:
    return [name for name, check in checks.items() if check.verdict is verdict]


def assert_told_in_sentences(checks: list[Check]) -> None:
    for check in checks:
        for text in (check.found, check.advice):
            assert text.strip(), check
            assert "\n" not in text, check
            assert not text.endswith("."), check
            assert ". " not in text.replace("e.g. ", ""), check
