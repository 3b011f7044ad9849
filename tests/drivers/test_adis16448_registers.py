from __future__ import annotations

import pytest

from drivers.adis16448.registers import REGISTERS, diagnoses

# Typed from the data sheet Rev. E, not from the code: address, access, flash, reset value, signed?, LSB.
SHEET = """
FLASH_CNT  00 R  1 -    u -
XGYRO_OUT  04 R  0 -    s 0.0006981317
YGYRO_OUT  06 R  0 -    s 0.0006981317
ZGYRO_OUT  08 R  0 -    s 0.0006981317
XACCL_OUT  0A R  0 -    s 0.00817220833
YACCL_OUT  0C R  0 -    s 0.00817220833
ZACCL_OUT  0E R  0 -    s 0.00817220833
XMAGN_OUT  10 R  0 -    s 1.428571e-8
YMAGN_OUT  12 R  0 -    s 1.428571e-8
ZMAGN_OUT  14 R  0 -    s 1.428571e-8
BARO_OUT   16 R  0 -    u 2.0
TEMP_OUT   18 R  0 -    t 0.07386
XGYRO_OFF  1A RW 1 0000 s 0.0001745329
YGYRO_OFF  1C RW 1 0000 s 0.0001745329
ZGYRO_OFF  1E RW 1 0000 s 0.0001745329
XACCL_OFF  20 RW 1 0000 s 0.00817220833
YACCL_OFF  22 RW 1 0000 s 0.00817220833
ZACCL_OFF  24 RW 1 0000 s 0.00817220833
XMAGN_HIC  26 RW 1 0000 s 1.428571e-8
YMAGN_HIC  28 RW 1 0000 s 1.428571e-8
ZMAGN_HIC  2A RW 1 0000 s 1.428571e-8
XMAGN_SIC  2C RW 1 0000 s 3.051851e-5
YMAGN_SIC  2E RW 1 0000 s 3.051851e-5
ZMAGN_SIC  30 RW 1 0000 s 3.051851e-5
GPIO_CTRL  32 RW 0 0000 b -
MSC_CTRL   34 RW 1 0006 b -
SMPL_PRD   36 RW 1 0001 b -
SENS_AVG   38 RW 1 0402 b -
SEQ_CNT    3A R  0 -    u -
DIAG_STAT  3C R  0 0000 b -
GLOB_CMD   3E W  0 0000 b -
ALM_MAG1   40 RW 1 0000 b -
ALM_MAG2   42 RW 1 0000 b -
ALM_SMPL1  44 RW 1 0000 u -
ALM_SMPL2  46 RW 1 0000 u -
ALM_CTRL   48 RW 1 0000 b -
LOT_ID1    52 R  1 -    u -
LOT_ID2    54 R  1 -    u -
PROD_ID    56 R  1 4040 u -
SERIAL_NUM 58 R  1 -    u -
"""
ROWS = [line.split() for line in SHEET.strip().splitlines()]
FORMS = {"u": "unsigned", "s": "signed", "t": "signed 12 bits", "b": "bits"}


def test_the_table_has_exactly_the_registers_of_the_data_sheet() -> None:
    assert sorted(REGISTERS) == sorted(row[0] for row in ROWS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_each_register_is_as_in_the_data_sheet(row: list[str]) -> None:
    name, address, access, flash, reset, form, lsb = row
    register = REGISTERS[name]
    assert register.address == int(address, 16)
    assert register.access == access
    assert register.flash == (flash == "1")
    assert register.reset == (None if reset == "-" else int(reset, 16))
    assert register.form == FORMS[form]
    if lsb != "-":
        assert register.lsb == pytest.approx(float(lsb), rel=1e-6)
    assert register.meaning


def test_status_bits_become_sentences_and_new_data_is_no_fault() -> None:
    assert diagnoses(0x0080) == []
    assert diagnoses(0x0480) == ["the x gyroscope failed its self-test"]
    assert diagnoses(0x1009) == [
        "the z gyroscope failed its self-test",
        "the part saw an SPI frame that was no multiple of 16 clocks",
        "the magnetometer failed its self-test",
    ]
    assert len(diagnoses(0xFFFF)) == 15
