from __future__ import annotations

import pytest
from pydantic import ValidationError

from drivers.adis16448.configuration import ImuSettings, RegisterBits, merged, register_bits


def test_the_defaults_are_usable_as_they_are() -> None:
    settings = ImuSettings()
    assert (settings.gyro_range_dps, settings.filter_taps_exponent, settings.decimation_exponent) == (
        500,
        2,
        0,
    )
    assert settings.nominal_rate_hz == 819.2
    assert settings.nominal_period_s == pytest.approx(1220.703125e-6)
    assert settings.filter_delay_s == pytest.approx(3.662e-3, abs=1e-6)


@pytest.mark.parametrize(("gyro_range", "least"), [(1000, 0), (500, 2), (250, 4)])
def test_a_range_with_too_few_taps_is_refused_in_one_sentence(gyro_range: int, least: int) -> None:
    ImuSettings.model_validate({"gyro_range_dps": gyro_range, "filter_taps_exponent": least})
    if least:
        with pytest.raises(ValidationError, match=f"{gyro_range} needs filter_taps_exponent >= {least}, not"):
            ImuSettings.model_validate({"gyro_range_dps": gyro_range, "filter_taps_exponent": least - 1})


@pytest.mark.parametrize(
    "wrong",
    [
        {"gyro_range": 250},
        {"gyro_range_dps": 300},
        {"filter_taps_exponent": 8},
        {"decimation_exponent": 6},
        {"block_samples": 0},
        {"block_samples": 65},
        {"data_ready_pin": 3},
        {"data_ready_line": -1},
        {"burst_crc": "maybe"},
        {"transport": "usb"},
        {"acquisition": "fork"},
        {"realtime_priority": 0},
        {"realtime_priority": 100},
    ],
)
def test_what_the_part_does_not_have_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        ImuSettings.model_validate(wrong)


def test_decimation_halves_the_rate_and_adds_half_a_block_of_delay() -> None:
    settings = ImuSettings(gyro_range_dps=1000, filter_taps_exponent=0, decimation_exponent=3)
    assert settings.nominal_rate_hz == 102.4
    assert settings.filter_delay_s == pytest.approx(3.5 / 819.2)


def test_the_table_writes_the_range_before_the_taps_it_limits() -> None:
    table = register_bits(ImuSettings(gyro_range_dps=250, filter_taps_exponent=5), crc=True)
    assert [bits.register for bits in table] == ["MSC_CTRL", "SMPL_PRD", "SENS_AVG", "SENS_AVG"]
    assert [bits.applied_to(0xFFFF) for bits in table] == [0xFFBE, 0xE0FF, 0xF9FF, 0xFFFD]
    assert [bits.applied_to(0x0000) for bits in table] == [0x0016, 0x0001, 0x0100, 0x0005]


def test_the_line_options_end_in_the_control_register() -> None:
    settings = ImuSettings(data_ready_pin=2, data_ready_active_high=False)
    assert register_bits(settings, crc=False)[0].applied_to(0x0006) == 0x0007


def test_bits_hold_only_where_both_kinds_are_as_wanted() -> None:
    bits = RegisterBits("SENS_AVG", 0x0200, 0x0500)
    assert bits.holds_in(0x0207)
    assert not bits.holds_in(0x0307)
    assert not bits.holds_in(0x0007)


def test_the_merged_table_has_one_line_per_register_with_the_bits_of_all() -> None:
    table = register_bits(ImuSettings(gyro_range_dps=250, filter_taps_exponent=5), crc=True)
    lines = merged(table)
    assert [bits.register for bits in lines] == ["MSC_CTRL", "SMPL_PRD", "SENS_AVG"]
    for value in (0x0000, 0xFFFF, 0x5A5A):
        for line in lines:
            expected = value
            for bits in table:
                if bits.register == line.register:
                    expected = bits.applied_to(expected)
            assert line.applied_to(value) == expected
