"""The program itself: configuration, versions, modules for the hardware."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import platform

from daemon.doctor.patient import Patient
from daemon.doctor.report import Check, fault, ok
from daemon.extras import how_to_bring
from daemon.recording.metadata import program_version
from daemon.settings import Settings
from drivers.can.dbc import find_signal

CONFIGURATION, PROGRAM = "configuration", "program"
_PACKAGES = ("python-can", "cantools", "numpy", "mcap", "pydantic")


def look(patient: Patient) -> list[Check]:
    """What everything else rests on."""
    return [_configuration(patient), judge_modules(patient.settings)]


def _configuration(patient: Patient) -> Check:
    """It was loaded, or there would be no patient; which frame it wants is worth a word."""
    settings = patient.settings
    name = str(patient.file) if patient.file else "no file, all defaults"
    if not settings.can.enabled:
        return ok(CONFIGURATION, f"{name}: good, without CAN")
    signal = find_signal(settings.can.displacement)
    return ok(CONFIGURATION, f"{name}: good, displacement {signal.message.name}.{signal.signal.name} {signal.frame_id}")


def judge_modules(settings: Settings) -> Check:
    """Versions, and whether what the hardware needs is installed."""
    versions = {name: _version(name) for name in _PACKAGES}
    missing = [module for module in needed_modules(settings) if importlib.util.find_spec(module) is None]
    found = f"ramstroke {program_version()}, Python {platform.python_version()}, Linux {platform.release()}, "
    found += ", ".join(f"{name} {version}" for name, version in versions.items())
    figures = {"versions": versions, "python": platform.python_version(), "kernel": platform.release()}
    if missing:
        return fault(
            PROGRAM,
            f"missing Python modules: {', '.join(missing)}; {found}",
            how_to_bring("hardware"),
            missing=missing,
            **figures,
        )
    return ok(PROGRAM, found, missing=[], **figures)


def needed_modules(settings: Settings) -> list[str]:
    """Of the extra `hardware`, by what the configuration names."""
    imu, jy901, needed = settings.imu, settings.jy901, []
    if jy901.use != "instead" and imu.transport == "spidev":
        needed.append("spidev")
        if imu.data_ready_line is not None:
            needed.append("gpiod")
    if jy901.use != "no" and jy901.transport == "serial":
        needed.append("serial")
    return needed


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "missing"
