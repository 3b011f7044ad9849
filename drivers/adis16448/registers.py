"""Register map of the ADIS16448 (data sheet Rev. E): one table for the driver and its virtual twin."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

STANDARD_GRAVITY = 9.80665  # m/s^2
BASE_RATE_HZ = 819.2  # internal clock, +-3 %
PRODUCT_ID = 0x4040  # 16448
INVALID_NS = 210_000  # the output registers change during this time before each data-ready edge

GYRO_LSB_DPS = {1000: 0.04, 500: 0.02, 250: 0.01}  # by range [deg/s]
ACCEL_LSB = STANDARD_GRAVITY / 1200  # m/s^2; the sheet's 0.833 mg is this, rounded
MAGN_LSB = 1e-7 / 7  # T: 1/7 mgauss
BARO_LSB = 2.0  # Pa, of an unsigned word
TEMP_LSB = 0.07386  # degC
TEMP_AT_ZERO_C = 31.0
GYRO_OFFSET_LSB = math.radians(0.01)  # rad/s, in every range

# MSC_CTRL
MSC_MEMORY_TEST = 1 << 11
MSC_SELF_TEST = 1 << 10
MSC_PERCUSSION = 1 << 6
MSC_BURST_CRC = 1 << 4
MSC_DATA_READY = 1 << 2
MSC_ACTIVE_HIGH = 1 << 1
MSC_ON_DIO2 = 1 << 0

# SMPL_PRD
SMPL_DECIMATION_SHIFT = 8
SMPL_DECIMATION_MASK = 0x1F00
SMPL_INTERNAL_CLOCK = 1 << 0

# SENS_AVG
AVG_RANGE_SHIFT = 8
AVG_RANGE_MASK = 0x0700
AVG_RANGE_CODE = {1000: 0b100, 500: 0b010, 250: 0b001}  # by range [deg/s]
AVG_TAPS_MASK = 0x0007
MIN_TAPS_EXPONENT = {1000: 0, 500: 2, 250: 4}  # by range [deg/s]

# GLOB_CMD
CMD_RESET = 1 << 7
CMD_FLASH_UPDATE = 1 << 3
CMD_FACTORY_RESTORE = 1 << 1
CMD_GYRO_BIAS = 1 << 0

# DIAG_STAT
DIAG_NEW_DATA = 1 << 7  # magnetometer and barometer; the only bit that is no fault
DIAG_MEMORY = 1 << 6
DIAG_SELF_TEST = 1 << 5
DIAG_OVERRANGE = 1 << 4
DIAG_SPI = 1 << 3
DIAG_BAROMETER = 1 << 1
DIAG_MAGNETOMETER = 1 << 0
DIAG_INERTIAL_PARTS = 0xFC00

DIAG_SENTENCES = {
    1 << 15: "the z accelerometer failed its self-test",
    1 << 14: "the y accelerometer failed its self-test",
    1 << 13: "the x accelerometer failed its self-test",
    1 << 12: "the z gyroscope failed its self-test",
    1 << 11: "the y gyroscope failed its self-test",
    1 << 10: "the x gyroscope failed its self-test",
    1 << 9: "alarm 2 is active",
    1 << 8: "alarm 1 is active",
    DIAG_MEMORY: "the program memory has a wrong checksum",
    DIAG_SELF_TEST: "the self-test failed",
    DIAG_OVERRANGE: "a sensor is beyond its range",
    DIAG_SPI: "the part saw an SPI frame that was no multiple of 16 clocks",
    1 << 2: "the last flash update failed",
    DIAG_BAROMETER: "the barometer failed its self-test",
    DIAG_MAGNETOMETER: "the magnetometer failed its self-test",
}


def diagnoses(diag_stat: int) -> list[str]:
    """The faults set in a DIAG_STAT word, as sentences, highest bit first."""
    return [sentence for bit, sentence in DIAG_SENTENCES.items() if diag_stat & bit]


Access = Literal["R", "RW", "W"]
Form = Literal["signed", "signed 12 bits", "unsigned", "bits"]


@dataclass(slots=True, frozen=True)
class Register:
    """One 16-bit register: low byte at `address`, high byte at `address` + 1."""

    name: str
    address: int
    access: Access
    flash: bool  # survives power-off after a flash update
    reset: int | None  # None: measured, or the part's own
    form: Form
    lsb: float | None  # in `unit`; None: no quantity
    unit: str
    meaning: str


def _axes(names: str, first: int, access: Access, form: Form, lsb: float, unit: str, meaning: str) -> list[Register]:
    writable = access == "RW"
    return [
        Register(
            names.replace("?", axis),
            first + 2 * i,
            access,
            writable,
            0 if writable else None,
            form,
            lsb,
            unit,
            f"{axis.lower()} {meaning}",
        )
        for i, axis in enumerate("XYZ")
    ]


_LARGEST_GYRO_LSB = math.radians(GYRO_LSB_DPS[1000])

_TABLE = [
    Register("FLASH_CNT", 0x00, "R", True, None, "unsigned", 1, "", "count of flash writes (lasts 10,000)"),
    *_axes("?GYRO_OUT", 0x04, "R", "signed", _LARGEST_GYRO_LSB, "rad/s", "rate, at the range 1000 deg/s"),
    *_axes("?ACCL_OUT", 0x0A, "R", "signed", ACCEL_LSB, "m/s^2", "specific force"),
    *_axes("?MAGN_OUT", 0x10, "R", "signed", MAGN_LSB, "T", "magnetic flux density"),
    Register("BARO_OUT", 0x16, "R", False, None, "unsigned", BARO_LSB, "Pa", "air pressure"),
    Register("TEMP_OUT", 0x18, "R", False, None, "signed 12 bits", TEMP_LSB, "degC", "inside, from 31 degC"),
    *_axes("?GYRO_OFF", 0x1A, "RW", "signed", GYRO_OFFSET_LSB, "rad/s", "rate offset"),
    *_axes("?ACCL_OFF", 0x20, "RW", "signed", ACCEL_LSB, "m/s^2", "specific force offset"),
    *_axes("?MAGN_HIC", 0x26, "RW", "signed", MAGN_LSB, "T", "hard-iron correction"),
    *_axes("?MAGN_SIC", 0x2C, "RW", "signed", 1 / 32767, "", "soft-iron correction"),
    Register("GPIO_CTRL", 0x32, "RW", False, 0x0000, "bits", None, "", "levels and directions of DIO1..DIO4"),
    Register("MSC_CTRL", 0x34, "RW", True, 0x0006, "bits", None, "", "tests, burst checksum, data-ready line"),
    Register("SMPL_PRD", 0x36, "RW", True, 0x0001, "bits", None, "", "clock source and decimation"),
    Register("SENS_AVG", 0x38, "RW", True, 0x0402, "bits", None, "", "gyro range and filter taps"),
    Register("SEQ_CNT", 0x3A, "R", False, None, "unsigned", 1, "", "samples until new field and pressure"),
    Register("DIAG_STAT", 0x3C, "R", False, 0x0000, "bits", None, "", "faults; reading clears all but bit 7"),
    Register("GLOB_CMD", 0x3E, "W", False, 0x0000, "bits", None, "", "commands; reading it starts a burst"),
    Register("ALM_MAG1", 0x40, "RW", True, 0x0000, "bits", None, "", "alarm 1 threshold, as its source"),
    Register("ALM_MAG2", 0x42, "RW", True, 0x0000, "bits", None, "", "alarm 2 threshold, as its source"),
    Register("ALM_SMPL1", 0x44, "RW", True, 0x0000, "unsigned", 1, "", "alarm 1 sample count"),
    Register("ALM_SMPL2", 0x46, "RW", True, 0x0000, "unsigned", 1, "", "alarm 2 sample count"),
    Register("ALM_CTRL", 0x48, "RW", True, 0x0000, "bits", None, "", "alarm sources, polarity and line"),
    Register("LOT_ID1", 0x52, "R", True, None, "unsigned", None, "", "lot code, first word"),
    Register("LOT_ID2", 0x54, "R", True, None, "unsigned", None, "", "lot code, second word"),
    Register("PROD_ID", 0x56, "R", True, PRODUCT_ID, "unsigned", None, "", "product number 16448"),
    Register("SERIAL_NUM", 0x58, "R", True, None, "unsigned", None, "", "serial number in bits 11..0"),
]

REGISTERS: dict[str, Register] = {register.name: register for register in _TABLE}
