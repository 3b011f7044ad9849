"""Settings of the inertial sensor, and the one table of register bits that follows from them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers.adis16448.registers import (
    AVG_RANGE_CODE,
    AVG_RANGE_MASK,
    AVG_RANGE_SHIFT,
    AVG_TAPS_MASK,
    BASE_RATE_HZ,
    MIN_TAPS_EXPONENT,
    MSC_ACTIVE_HIGH,
    MSC_BURST_CRC,
    MSC_DATA_READY,
    MSC_ON_DIO2,
    MSC_PERCUSSION,
    SMPL_DECIMATION_MASK,
    SMPL_DECIMATION_SHIFT,
    SMPL_INTERNAL_CLOCK,
)


class ImuSettings(BaseModel):
    """How the ADIS16448 is wired and read."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    transport: Annotated[
        Literal["spidev", "socket", "virtual"],
        Field(description="the kernel's SPI port, the socket of `ramstroke sim`, or the virtual part"),
    ] = "spidev"
    spi_device: Annotated[str, Field(description="SPI port of the sensor")] = "/dev/spidev0.0"
    socket_path: Annotated[str, Field(description="Unix socket of `ramstroke sim`")] = "/run/ramstroke-sim/imu.sock"
    data_ready_chip: Annotated[str, Field(description="GPIO chip of the data-ready line")] = "/dev/gpiochip0"
    data_ready_line: Annotated[
        int | None, Field(ge=0, description="its number on that chip; without one, reads are paced")
    ] = None
    data_ready_pin: Annotated[Literal[1, 2], Field(description="DIO pin of the part wired to that line")] = 1
    data_ready_active_high: Annotated[
        bool, Field(description="GPIO line high while data are valid; false behind an inverting level shifter")
    ] = True
    gyro_range_dps: Annotated[Literal[250, 500, 1000], Field(description="gyro range [deg/s]")] = 500
    filter_taps_exponent: Annotated[
        int,
        Field(
            ge=0,
            le=7,
            description="B: two averages of 2^B samples in cascade; 500 deg/s needs 2, 250 needs 4",
        ),
    ] = 2
    decimation_exponent: Annotated[
        int, Field(ge=0, le=5, description="D: output averaged and thinned by 2^D, 819.2 to 25.6 samples/s")
    ] = 0
    burst_crc: Annotated[
        Literal["auto", "on", "off"], Field(description="checksum of bursts; auto: if the part has one")
    ] = "auto"
    block_samples: Annotated[int, Field(ge=1, le=64, description="samples handed over at a time")] = 8
    acquisition: Annotated[
        Literal["thread", "process"],
        Field(description="read in a thread of the daemon, or in a process of its own that nothing else delays"),
    ] = "thread"
    realtime_priority: Annotated[
        int | None,
        Field(ge=1, le=99, description="SCHED_FIFO priority of the thread that reads; without one it has none"),
    ] = None

    @model_validator(mode="after")
    def _filter_fits_range(self) -> ImuSettings:
        least = MIN_TAPS_EXPONENT[self.gyro_range_dps]
        if self.filter_taps_exponent < least:
            raise ValueError(
                f"gyro_range_dps = {self.gyro_range_dps} needs filter_taps_exponent >= {least}, "
                f"not {self.filter_taps_exponent}: the part would raise it by itself"
            )
        return self

    @property
    def nominal_rate_hz(self) -> float:
        """Output rate by the data sheet; the part's clock is up to 3 % off."""
        return BASE_RATE_HZ / (1 << self.decimation_exponent)

    @property
    def nominal_period_s(self) -> float:
        """Time between two outputs by the data sheet."""
        return 1 / self.nominal_rate_hz

    @property
    def filter_delay_s(self) -> float:
        """Delay of the digital filters: 2^B - 1 samples of the averages, half a block of the decimation."""
        taps, decimation = 1 << self.filter_taps_exponent, 1 << self.decimation_exponent
        return (taps - 1 + (decimation - 1) / 2) / BASE_RATE_HZ


class RegisterBits(NamedTuple):
    """Bits of one register to set and to clear; all others stay as they are."""

    register: str
    to_set: int
    to_clear: int

    def applied_to(self, value: int) -> int:
        """`value` with these bits set and cleared."""
        return value & ~self.to_clear | self.to_set

    def holds_in(self, value: int) -> bool:
        """Whether these bits are as wanted."""
        return self.applied_to(value) == value


def merged(table: Iterable[RegisterBits]) -> tuple[RegisterBits, ...]:
    """The table with one line per register."""
    lines: dict[str, RegisterBits] = {}
    for name, to_set, to_clear in table:
        known = lines.get(name, RegisterBits(name, 0, 0))
        lines[name] = RegisterBits(name, known.to_set | to_set, known.to_clear | to_clear)
    return tuple(lines.values())


def _field(register: str, mask: int, value: int) -> RegisterBits:
    return RegisterBits(register, value, mask & ~value)


def register_bits(settings: ImuSettings, *, crc: bool) -> tuple[RegisterBits, ...]:
    """What the registers must hold, in the order of writing (the range before the taps it limits)."""
    msc_mask = MSC_PERCUSSION | MSC_BURST_CRC | MSC_DATA_READY | MSC_ACTIVE_HIGH | MSC_ON_DIO2
    msc = (
        MSC_DATA_READY
        | MSC_ACTIVE_HIGH  # always: data_ready_active_high says what the way from the pin to the GPIO makes of it
        | (MSC_BURST_CRC if crc else 0)
        | (MSC_ON_DIO2 if settings.data_ready_pin == 2 else 0)
    )
    decimation = settings.decimation_exponent << SMPL_DECIMATION_SHIFT
    gyro_range = AVG_RANGE_CODE[settings.gyro_range_dps] << AVG_RANGE_SHIFT
    return (
        _field("MSC_CTRL", msc_mask, msc),
        _field("SMPL_PRD", SMPL_DECIMATION_MASK | SMPL_INTERNAL_CLOCK, decimation | SMPL_INTERNAL_CLOCK),
        _field("SENS_AVG", AVG_RANGE_MASK, gyro_range),
        _field("SENS_AVG", AVG_TAPS_MASK, settings.filter_taps_exponent),
    )
