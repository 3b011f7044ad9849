"""Settings of the CAN side, refused with a sentence when they cannot work."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

PresetName = Literal["support_controller", "cia406", "j1939_proprietary_b"]
Unit = Literal["mm", "m", "cm", "um"]
ChecksumName = Literal["crc8_j1850", "crc8_autosar", "sum8", "xor8"]

LARGEST_STANDARD_ID = 0x7FF
LARGEST_EXTENDED_ID = 0x1FFFFFFF

ArbitrationId = Annotated[int, Field(ge=0, le=LARGEST_EXTENDED_ID)]


class CanConfigError(ValueError):
    """The CAN settings do not fit a DBC file or each other; the text names the option and what to do."""


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class DisplacementSettings(_Settings):
    """Which frame carries a displacement, and when its value may be believed.

    A preset fills in DBC file, message, signal, validity, counter and checksum; each of them can be overridden.
    """

    preset: PresetName | None = Field(
        default="support_controller",
        description="Ready-made frame layout; not together with `dbc`.",
    )
    dbc: Path | None = Field(default=None, description="Own DBC file that describes the frame, instead of a preset.")
    message: str | None = Field(default=None, description="Message of the DBC file; with a preset: its own.")
    signal: str | None = Field(default=None, description="Displacement signal of the message; with a preset: its own.")
    unit: Unit | None = Field(
        default=None,
        description="Unit of the signal; needed only when the DBC file does not state mm, cm, m or um.",
    )
    arbitration_id: ArbitrationId | None = Field(
        default=None,
        description="Identifier on the bus when it differs from the DBC file's, e.g. another J1939 source "
        "address or CANopen PDO; its width (11 or 29 bits) stays that of the DBC file.",
    )
    node_id: int | None = Field(
        default=None,
        ge=1,
        le=127,
        description="CANopen node number, preset cia406 only (there the default is 127).",
    )
    minimum_mm: float = Field(
        default=-50.0,
        ge=-1e6,
        le=1e6,
        description="Smallest believable value [mm], below maximum_mm; one below it counts as out of range.",
    )
    maximum_mm: float = Field(
        default=1000.0,
        ge=-1e6,
        le=1e6,
        description="Largest believable value [mm]; one above it counts as out of range.",
    )
    valid_signal: str | None = Field(
        default=None, description="Signal of the same message that tells whether the displacement is valid."
    )
    valid_value: int | None = Field(
        default=None, description="Raw value of `valid_signal` that means valid; 1 if not given."
    )
    counter_signal: str | None = Field(
        default=None,
        description="Signal of the same message that counts its frames; a frame that repeats the last number is "
        "not believed.",
    )
    checksum_signal: str | None = Field(
        default=None, description="Signal of the same message, one whole byte, with a checksum over all other bytes."
    )
    checksum: ChecksumName | None = Field(default=None, description="How `checksum_signal` is computed.")
    timeout_ms: float = Field(
        default=1000.0,
        gt=0,
        le=60_000,
        description="The source counts as silent after this long without a frame [ms].",
    )
    latency_ms: float = Field(
        default=17.5,
        ge=0,
        le=1000,
        description="Age of the measured value when its frame arrives, on average [ms].",
    )

    @model_validator(mode="before")
    @classmethod
    def _own_dbc_replaces_the_default_preset(cls, values: Any) -> Any:
        if isinstance(values, dict) and values.get("dbc") is not None and "preset" not in values:
            return {**values, "preset": None}
        return values

    @model_validator(mode="after")
    def _options_fit_together(self) -> DisplacementSettings:
        if self.preset is not None and self.dbc is not None:
            raise ValueError("`preset` and `dbc` exclude each other: delete one of them")
        if self.preset is None and None in (self.dbc, self.message, self.signal):
            raise ValueError("without a preset `dbc`, `message` and `signal` are needed: add the missing ones")
        if self.node_id is not None and self.preset != "cia406":
            raise ValueError('`node_id` belongs to CANopen: delete it or set preset = "cia406"')
        if self.valid_value is not None and self.valid_signal is None:
            raise ValueError("`valid_value` needs `valid_signal`: name the signal or delete the value")
        if (self.checksum_signal is None) != (self.checksum is None):
            raise ValueError("`checksum_signal` and `checksum` belong together: add the missing one")
        if self.minimum_mm >= self.maximum_mm:
            raise ValueError("`minimum_mm` must be smaller than `maximum_mm`")
        return self


class PublishSettings(_Settings):
    """Sending of our own estimate frame (config/dbc/ramstroke_estimate.dbc)."""

    enabled: bool = Field(default=False, description="Send the estimate; needs `listen_only = false`.")
    arbitration_id: ArbitrationId = Field(
        default=0x6F0,
        description="Identifier of the estimate frame; must be free on the bus; up to 0x7FF unless extended.",
    )
    extended: bool = Field(default=False, description="Use a 29-bit identifier.")
    period_ms: float = Field(default=100.0, ge=10, le=10_000, description="Time between two estimate frames [ms].")

    @model_validator(mode="after")
    def _identifier_fits_its_width(self) -> PublishSettings:
        if not self.extended and self.arbitration_id > LARGEST_STANDARD_ID:
            raise ValueError(
                f"`arbitration_id` 0x{self.arbitration_id:X} needs more than 11 bits: set `extended = true`"
            )
        return self


class CanSettings(_Settings):
    """The CAN interface and what is read from and written to it."""

    enabled: bool = Field(default=True, description="Use CAN at all; false means inertial only.")
    interface: Literal["socketcan", "udp_multicast", "virtual"] = Field(
        default="socketcan",
        description="Kind of interface: socketcan for a support, udp_multicast for trials on one computer "
        "without CAN hardware, virtual within one process.",
    )
    channel: str = Field(
        default="can0",
        min_length=1,
        description="Network interface; for udp_multicast a multicast address such as 239.74.163.2.",
    )
    port: int = Field(default=43113, ge=1, le=65535, description="UDP port, udp_multicast only.")
    listen_only: bool = Field(default=True, description="Never send a frame, whatever else is set.")
    displacement: DisplacementSettings = Field(
        default_factory=DisplacementSettings, description="The controller's displacement, used to estimate."
    )
    reference: DisplacementSettings | None = Field(
        default=None, description="A laboratory sensor, recorded and compared with, never used to estimate."
    )
    publish: PublishSettings = Field(default_factory=PublishSettings, description="Our estimate as a CAN frame.")

    @model_validator(mode="after")
    def _options_fit_together(self) -> CanSettings:
        if self.publish.enabled and self.listen_only:
            raise ValueError(
                "`publish.enabled` needs the right to send: set `listen_only = false` or disable publishing"
            )
        if self.interface == "udp_multicast" and not _is_multicast(self.channel):
            raise ValueError(
                f'`channel` "{self.channel}" is no multicast address: udp_multicast needs one, such as 239.74.163.2'
            )
        return self


def _is_multicast(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_multicast
    except ValueError:
        return False
