"""Frame layouts that need no DBC file of the user's own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drivers.can.settings import ChecksumName, PresetName

DBC_FOLDER = Path(__file__).resolve().parents[2] / "config" / "dbc"


@dataclass(slots=True, frozen=True)
class Preset:
    """Where a displacement sits in one of our DBC files."""

    dbc: Path
    message: str
    signal: str
    valid_signal: str | None = None
    valid_value: int = 1
    counter_signal: str | None = None
    checksum_signal: str | None = None
    checksum: ChecksumName | None = None
    # SAE J1939-71: raw positions from here on are no positions but say "error" or "not available".
    lowest_code: int | None = None
    # Some makers append bytes (a status, padding) to the standard layout.
    may_be_longer: bool = False


PRESETS: dict[PresetName, Preset] = {
    "support_controller": Preset(
        DBC_FOLDER / "support_controller.dbc",
        "SupportStatus",
        "ram_stroke",
        "ram_stroke_valid",
        counter_signal="counter",
        checksum_signal="checksum",
        checksum="crc8_j1850",
    ),
    "cia406": Preset(DBC_FOLDER / "cia406.dbc", "Position", "position", may_be_longer=True),
    "j1939_proprietary_b": Preset(
        DBC_FOLDER / "j1939_proprietary_b.dbc",
        "StrokeProprietaryB",
        "position",
        "error_code",
        valid_value=0,
        lowest_code=0xFE00,
    ),
}
