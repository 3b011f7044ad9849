"""What many readings of one register mean, how a line answers to its pin, and which lines may be watched."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from enum import Enum
from types import ModuleType
from typing import Any

import pytest

from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.performance import accel_noise, noise_gain
from drivers.adis16448.probe import IdKind, LineKind, LineReaction, meaning_of_ids
from drivers.adis16448.registers import PRODUCT_ID, STANDARD_GRAVITY
from drivers.data_ready import free_inputs


@pytest.mark.parametrize(
    ("readings", "kind"),
    [
        ([PRODUCT_ID] * 4, IdKind.RIGHT),
        ([0x0000] * 4, IdKind.LOW),
        ([0xFFFF] * 4, IdKind.HIGH),
        ([PRODUCT_ID] * 3 + [0x4041], IdKind.WANDERING),
        ([0x0000, 0xFFFF], IdKind.WANDERING),
        ([16445] * 4, IdKind.OTHER_PART),
        ([PRODUCT_ID >> 1] * 4, IdKind.WRONG),
        ([0x5AA5] * 4, IdKind.WRONG),
    ],
)
def test_every_way_to_read_the_product_has_its_word(readings: list[int], kind: IdKind) -> None:
    meaning = meaning_of_ids(readings)
    assert meaning.kind is kind
    assert bool(meaning.advice) is (kind is not IdKind.RIGHT)


@pytest.mark.parametrize(
    ("on_hz", "off_hz", "kind"),
    [
        (824.0, 0.0, LineKind.FOLLOWS),
        (824.0, 100.0, LineKind.FOLLOWS),  # a pin that is not driven floats
        (0.0, 0.0, LineKind.SILENT),
        (4.0, 8.0, LineKind.SILENT),
        (50.0, 50.0, LineKind.STRANGER),
        (819.2, 819.2, LineKind.STRANGER),
        (0.0, 400.0, LineKind.STRANGER),
        (400.0, 0.0, LineKind.TOO_FEW),
        (1600.0, 0.0, LineKind.TOO_MANY),
    ],
)
def test_a_line_is_known_by_how_it_follows(on_hz: float, off_hz: float, kind: LineKind) -> None:
    assert LineReaction(on_hz, off_hz).kind(819.2) is kind


def test_the_filters_let_as_much_noise_through_as_the_sheet_s_figures_say() -> None:
    # Two averages of 2^B in cascade: 1, 0.612, 0.415 of the noise.
    for exponent, gain in ((2, 0.415), (3, 0.290), (7, 0.072)):
        assert noise_gain(ImuSettings(filter_taps_exponent=exponent)) == pytest.approx(gain, abs=6e-4)
    unfiltered = ImuSettings(filter_taps_exponent=0, gyro_range_dps=1000)
    assert accel_noise(unfiltered) == pytest.approx(0.0051 * STANDARD_GRAVITY, rel=0.01)
    assert noise_gain(ImuSettings(decimation_exponent=3)) < noise_gain(ImuSettings())


@dataclass
class LineInfo:
    offset: int
    name: str | None
    used: bool
    direction: Any


def test_only_lines_that_are_nobody_s_are_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    class Direction(Enum):
        INPUT = 1
        OUTPUT = 2

    lines = [
        LineInfo(0, "ID_SDA", False, Direction.INPUT),
        LineInfo(1, "GPIO24", False, Direction.INPUT),
        LineInfo(2, "GPIO25", True, Direction.INPUT),
        LineInfo(3, "GPIO26", False, Direction.OUTPUT),
        LineInfo(4, None, False, Direction.INPUT),
        LineInfo(5, "SPI_MISO", False, Direction.INPUT),
    ]

    class Chip:
        def __init__(self, path: str) -> None:
            if path != "/dev/gpiochip0":
                raise FileNotFoundError(2, "No such file or directory", path)

        def __enter__(self) -> Chip:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def get_info(self) -> Any:
            return type("Info", (), {"num_lines": len(lines)})

        def get_line_info(self, offset: int) -> LineInfo:
            return lines[offset]

    gpiod, line = ModuleType("gpiod"), ModuleType("gpiod.line")
    gpiod.__dict__.update(Chip=Chip, line=line)
    line.__dict__["Direction"] = Direction
    monkeypatch.setitem(sys.modules, "gpiod", gpiod)
    monkeypatch.setitem(sys.modules, "gpiod.line", line)
    assert free_inputs("/dev/gpiochip0") == [1, 4]
    assert free_inputs("/dev/gpiochip9") == []
