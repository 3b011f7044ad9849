"""Settings of the JY901: whether there is one, where it hangs, how it is set up."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers.jy901.packets import highest_rate_hz

GROUP = 2  # packets of a sample: acceleration and rate


class Jy901Settings(BaseModel):
    """A WitMotion JY901 on a serial line: the inertial sensor in place of the ADIS16448, or one recorded beside it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    use: Literal["no", "instead", "beside"] = Field(
        "no",
        description="`instead`: the estimate comes from it, and there is no ADIS16448; `beside`: it is recorded as a "
        "second sensor, which `align` compares, and the estimate does not know of it",
    )
    transport: Literal["serial", "virtual"] = Field("serial", description="a serial port, or the virtual part")
    port: str = Field(
        "/dev/ttyUSB0",
        min_length=1,
        description="serial port; `ramstroke sim` puts the virtual one's pseudo-terminal there",
    )
    baud: Literal[9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600] = Field(
        115200, description="baud rate to use [Bd]; at the start the part is found at any other, too"
    )
    rate_hz: Literal[10, 20, 50, 100, 200] = Field(200, description="samples a second [Hz]")
    bandwidth_hz: Literal[5, 10, 21, 44, 94, 184, 256] | None = Field(
        None,
        description="the part's low-pass filter [Hz]; not set: the highest up to half of rate_hz, so that no vibration "
        "beyond it folds into what is seen; firmware that then sends fewer samples wants one above rate_hz",
    )
    save: bool = Field(
        False, description="save baud rate, sample rate and filter in the part, so that it starts with them"
    )

    @model_validator(mode="after")
    def _line_carries_rate(self) -> Self:
        highest = highest_rate_hz(self.baud, GROUP)
        if self.rate_hz > highest:
            raise ValueError(
                f"rate_hz = {self.rate_hz} is too much for baud = {self.baud}, which carries {highest} samples a "
                "second: choose a higher baud rate or a lower sample rate"
            )
        return self
