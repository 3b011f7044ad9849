"""Sensor grades: those that come with the program, and a user's own file of the same form."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from pydantic import ValidationError

from daemon.toml_errors import ConfigurationError, plain, read_toml
from estimation.alignment.sensor import SensorGrade

SHOWN = 4  # faults of a file


def load_grades(path: Path | None = None) -> dict[str, SensorGrade]:
    """The program's own grades, and those of the file, which take precedence. Raises ConfigurationError."""
    own = Path(str(files("config") / "sensor_grades.toml"))
    return _read(own) if path is None else _read(own) | _read(path)


def _read(path: Path) -> dict[str, SensorGrade]:
    _, tree = read_toml(path, "file of sensor grades")
    grades, faults = {}, []
    for name, values in tree.items():
        try:
            grades[name] = SensorGrade.model_validate(values, strict=False)
        except ValidationError as error:
            faults += [
                f"{path}: [{name}] {'.'.join(map(str, fault['loc']))}: {plain(fault['msg'])}"
                for fault in error.errors()
            ]
    if faults:
        more = (
            [f"{path}: and {len(faults) - SHOWN} more; is it a file of sensor grades?"] if len(faults) > SHOWN else []
        )
        raise ConfigurationError(faults[:SHOWN] + more)
    return grades
