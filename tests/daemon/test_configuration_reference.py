"""The reference of the settings is up to date and misses no key."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pydantic import BaseModel, Field

from daemon import configuration_reference
from daemon.configuration_reference import generate, nested_model, sections
from daemon.settings import Settings

PAGE = Path(__file__).parents[2] / "docs" / "configuration.md"
UNIT_OF_SUFFIX = {
    "_mm_s": "mm/s",
    "_mm": "mm",
    "_ms": "ms",
    "_mb": "MB",
    "_minutes": "min",
    "_dps": "deg/s",
}


def test_the_page_in_the_repository_is_what_the_models_say() -> None:
    assert PAGE.read_text(encoding="utf-8") == generate(), (
        "run: python -m daemon.configuration_reference > docs/configuration.md"
    )


def test_every_nested_table_is_a_section_of_its_own() -> None:
    assert [name for name, _ in sections(Settings)] == [
        "imu",
        "jy901",
        "jy901_mount",
        "can",
        "can.displacement",
        "can.reference",
        "can.publish",
        "mount",
        "support",
        "estimator",
        "two_state",
        "recording",
        "service",
        "simulation",
    ]


@pytest.mark.parametrize(("section", "model"), list(sections(Settings)), ids=lambda value: str(value))
def test_every_plain_key_of_a_model_has_one_row_in_its_section(section: str, model: type[BaseModel]) -> None:
    if section == "can.reference":
        section = "can.displacement"  # the same model, described there
    rows = _rows(section)
    plain = [key for key, field in model.model_fields.items() if nested_model(field.annotation) is None]
    assert [row[0] for row in rows] == [f"`{key}`" for key in plain]


@pytest.mark.parametrize(("section", "model"), list(sections(Settings)), ids=lambda value: str(value))
def test_every_key_says_what_it_means(section: str, model: type[BaseModel]) -> None:
    unsaid = [
        f"[{section}] {key}"
        for key, field in model.model_fields.items()
        if nested_model(field.annotation) is None and not field.description
    ]
    assert unsaid == []
    assert (model.__doc__ or "").strip()


def test_a_unit_in_the_name_of_a_key_is_the_unit_in_its_row() -> None:
    compared = 0
    for section, model in sections(Settings):
        units = {row[0].strip("`"): row[2] for row in _rows(section)}
        for key in model.model_fields:
            suffix = next((suffix for suffix in UNIT_OF_SUFFIX if key.endswith(suffix)), None)
            if suffix is not None and key in units:
                assert units[key] == UNIT_OF_SUFFIX[suffix], f"[{section}] {key}"
                compared += 1
    assert compared >= 20


def test_limits_choices_and_defaults_stand_as_toml_would_have_them() -> None:
    imu = {row[0]: row for row in _rows("imu")}
    assert imu["`transport`"][3:] == ['`"spidev"`, `"socket"`, `"virtual"`', '`"spidev"`']
    assert imu["`data_ready_line`"][3:] == ["whole number ≥ 0", "not set"]
    assert imu["`gyro_range_dps`"][2:] == ["deg/s", "`250`, `500`, `1000`", "`500`"]
    publish = {row[0]: row for row in _rows("can.publish")}
    assert publish["`arbitration_id`"][3:] == ["whole number ≥ 0x0, ≤ 0x1FFFFFFF", "`0x6F0`"]
    assert publish["`extended`"][3:] == ["`true`, `false`", "`false`"]
    recording = {row[0]: row for row in _rows("recording")}
    assert recording["`rotate_minutes`"][2:] == ["min", "number > 0, ≤ 10080", "`60`"]


def test_a_key_without_a_description_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    class Mute(BaseModel):
        """A section."""

        loudness: int = 1

    class File(BaseModel):
        """A file."""

        horn: Mute = Field(default_factory=Mute)

    monkeypatch.setattr(configuration_reference, "Settings", File)
    with pytest.raises(ValueError, match=r"\[horn\] loudness has no description"):
        generate()


def _rows(section: str) -> list[list[str]]:
    """Cells of the table under a heading of the generated page."""
    found = re.search(rf"^## \[{re.escape(section)}\]\n(.*?)(?=^## |\Z)", generate(), re.M | re.S)
    assert found is not None, section
    lines = [line for line in found[1].splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
