"""Fault scripts: what goes wrong with the virtual devices, when, and for how long.

A script says what happens at the pins and on the bus, never what a driver should make of it. All times
count from the start of the simulation.
"""

from __future__ import annotations

import hashlib
import random
import struct
from dataclasses import dataclass
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

_LONGEST_S = 1e7  # four months

SelfTestPart = Literal[
    "x_gyro", "y_gyro", "z_gyro", "x_accl", "y_accl", "z_accl", "memory", "barometer", "magnetometer"
]
Axis = Literal["x_gyro", "y_gyro", "z_gyro", "x_accl", "y_accl", "z_accl"]
CanError = Literal["warning", "passive", "overflow", "bit_stuffing", "no_acknowledge", "lost_arbitration"]


class Fault(BaseModel):
    """One thing that goes wrong."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    at_s: float = Field(ge=0, le=_LONGEST_S, description="begin, after the start of the simulation [s]")
    for_s: float = Field(gt=0, le=_LONGEST_S, description="how long it lasts [s]")

    @property
    def sentence(self) -> str:
        """What happens, for people."""
        kind = type(self).model_fields["kind"].default
        chosen = self.model_dump(exclude={"at_s", "for_s", "kind"}, exclude_none=True)
        values = "".join(f", {key} = {value}" for key, value in chosen.items())
        return f"{kind} for {self.for_s:g} s{values}: {type(self).__doc__}"


def _share(default: float, of_what: str) -> Any:
    return Field(default, gt=0, le=1, description=f"share of the {of_what} that it meets")


# --- the inertial sensor and its wires ----------------------------------------------------------------------


class MisoLow(Fault):
    """The data wire is shorted to ground: every answer is zeros."""

    kind: Literal["miso_low"] = "miso_low"


class MisoHigh(Fault):
    """The data wire is broken and its pull-up wins: every answer is ones."""

    kind: Literal["miso_high"] = "miso_high"


class BitFlips(Fault):
    """Interference or a bad contact on the data wire: single bits arrive wrong, in bursts and register reads."""

    kind: Literal["bit_flips"] = "bit_flips"
    probability: float = Field(1e-3, gt=0, le=0.5, description="probability of each bit to be wrong")


class BrownOut(Fault):
    """The supply dips: the part is off, starts again with reset and flash values, and has data 205 ms later."""

    kind: Literal["brown_out"] = "brown_out"


class DataReadyLost(Fault):
    """The data-ready wire is broken or loose: edges do not arrive; the part goes on sampling."""

    kind: Literal["data_ready_lost"] = "data_ready_lost"
    share: float = _share(1.0, "edges")


class DataReadyDoubled(Fault):
    """The data-ready line rings: a second edge soon after one."""

    kind: Literal["data_ready_doubled"] = "data_ready_doubled"
    share: float = _share(0.5, "edges")
    after_us: float = Field(20.0, ge=1, le=1000, description="time between the two edges [us]")


class SpiErrors(Fault):
    """The SPI port of the computer fails: a transfer ends in an error instead of an answer."""

    kind: Literal["spi_error"] = "spi_error"
    share: float = _share(1.0, "transfers")


class SlowSpi(Fault):
    """The SPI port is busy: every transfer begins late."""

    kind: Literal["slow_spi"] = "slow_spi"
    extra_us: float = Field(500.0, gt=0, le=100_000, description="how much later each transfer begins [us]")


class RepeatedSamples(Fault):
    """The part hangs: its output registers freeze while the data-ready edges go on."""

    kind: Literal["repeated_samples"] = "repeated_samples"


class SelfTestFailure(Fault):
    """A part of the sensor is damaged, or a magnet lies nearby: self-tests that end meanwhile fail."""

    kind: Literal["self_test_failure"] = "self_test_failure"
    parts: tuple[SelfTestPart, ...] = Field(("x_gyro",), min_length=1, description="what fails")


class WrongProductId(Fault):
    """Another sensor of the family is fitted, or the part wakes up slowly: PROD_ID is not 16448."""

    kind: Literal["wrong_product_id"] = "wrong_product_id"
    product_id: int = Field(16445, ge=0, le=0xFFFF, description="what register PROD_ID holds")


class Unplugged(Fault):
    """The connector is off: all answers are ones, no edges; back on, the part starts as after any power-off."""

    kind: Literal["unplugged"] = "unplugged"


class Replaced(Fault):
    """The connector is off, and then another part hangs on it: other serial number, lot and biases."""

    kind: Literal["replaced"] = "replaced"
    serial: int = Field(2345, ge=1, le=4094, description="SERIAL_NUM of the new part")
    lot_id: int = Field(0x1824_0077, ge=0, le=0xFFFF_FFFF, description="LOT_ID1 and LOT_ID2 of the new part")


class Overrange(Fault):
    """One axis is beyond its range: its readings are saturated and DIAG_STAT says so."""

    kind: Literal["overrange"] = "overrange"
    axis: Axis = Field("z_accl", description="which axis")


class LateEdges(Fault):
    """The computer is busy: edges are stamped when they happen but delivered late and several at once."""

    kind: Literal["late_edges"] = "late_edges"
    every_ms: float = Field(20.0, gt=0, le=1000, description="time between two deliveries [ms]")


# --- a JY901 and its serial line -----------------------------------------------------------------------------


class SerialCut(Fault):
    """The JY901's cable is off: no byte gets through, either way; the part goes on."""

    kind: Literal["serial_cut"] = "serial_cut"


class SerialDrops(Fault):
    """A bad contact, or a computer too slow for its port: bytes are lost, so that packets come in halves."""

    kind: Literal["serial_drops"] = "serial_drops"
    share: float = _share(0.02, "bytes")


class SerialFlips(Fault):
    """Interference on the serial line: single bits arrive wrong."""

    kind: Literal["serial_flips"] = "serial_flips"
    probability: float = Field(1e-3, gt=0, le=0.5, description="probability of each bit to be wrong")


class SerialGarbage(Fault):
    """Interference that looks like packets: random bytes behind a true head, between the part's own."""

    kind: Literal["serial_garbage"] = "serial_garbage"
    rate_hz: float = Field(20.0, gt=0, le=1000, description="how often [Hz]")


class SerialHeaps(Fault):
    """A USB adapter collects bytes and hands them over in heaps."""

    kind: Literal["serial_heaps"] = "serial_heaps"
    every_ms: float = Field(16.0, gt=0, le=1000, description="time between two heaps [ms]")


class AdapterGone(Fault):
    """The USB adapter is pulled out: its serial port is gone from the computer."""

    kind: Literal["adapter_gone"] = "adapter_gone"


class Jy901BrownOut(Fault):
    """The JY901 is without supply, then starts as it was saved: 9600 baud, 10 samples a second."""

    kind: Literal["jy901_brown_out"] = "jy901_brown_out"


class Jy901Frozen(Fault):
    """The JY901 hangs: it repeats the values of the beginning."""

    kind: Literal["jy901_frozen"] = "jy901_frozen"


class Jy901DeadBand(Fault):
    """The JY901's dead band is on: rates below 1.1 deg/s read exactly zero."""

    kind: Literal["jy901_dead_band"] = "jy901_dead_band"


# --- the controller and its bus -----------------------------------------------------------------------------


class CanSilence(Fault):
    """The controller is off or its branch is cut: it sends nothing; other senders go on."""

    kind: Literal["can_silence"] = "can_silence"


class StuckValue(Fault):
    """The displacement sensor hangs: frames go on with the value of the beginning."""

    kind: Literal["stuck_value"] = "stuck_value"


class Jump(Fault):
    """The sensor's magnet or lever slipped: every value is off by the same amount."""

    kind: Literal["jump"] = "jump"
    offset_mm: float = Field(ge=-10_000, le=10_000, description="added to every value [mm]")


class Drift(Fault):
    """The sensor's electronics run away: the error grows steadily."""

    kind: Literal["drift"] = "drift"
    mm_s: float = Field(ge=-1000, le=1000, description="growth of the error [mm/s]")


class NoiseBurst(Fault):
    """Interference on the sensor's analog side: values scatter."""

    kind: Literal["noise_burst"] = "noise_burst"
    sigma_mm: float = Field(20.0, gt=0, le=10_000, description="standard deviation of the noise added [mm]")


class SensorError(Fault):
    """The displacement sensor knows that it is ill, and its frames say so."""

    kind: Literal["sensor_error"] = "sensor_error"


class Delayed(Fault):
    """A gateway is overloaded: readings come later, in their order."""

    kind: Literal["delayed"] = "delayed"
    latency_ms: float = Field(200.0, gt=0, le=60_000, description="how much later [ms]")


class WrongIdentifier(Fault):
    """The controller was set up anew: displacement frames carry another identifier."""

    kind: Literal["wrong_identifier"] = "wrong_identifier"
    arbitration_id: int = Field(0x3FF, ge=0, le=0x7FF, description="their identifier, 11 bits")


class WrongLength(Fault):
    """Another firmware: displacement frames have another length, cut or filled with zeros."""

    kind: Literal["wrong_length"] = "wrong_length"
    length: int = Field(1, ge=0, le=8, description="their length [bytes]")


class Corrupted(Fault):
    """A gateway damages payloads: one bit of the frame's data is wrong, its own checksum does not fit."""

    kind: Literal["corrupted"] = "corrupted"
    share: float = _share(1.0, "displacement frames")


class FrozenFrame(Fault):
    """The controller's program hangs while its CAN hardware repeats the last frame, counter and all."""

    kind: Literal["frozen_frame"] = "frozen_frame"


class ErrorFrames(Fault):
    """A bad bus: the CAN hardware reports errors (linux/can/error.h); frames still come through."""

    kind: Literal["error_frames"] = "error_frames"
    error: CanError = Field(
        "bit_stuffing", description="what is reported (after warning and passive, error-active once)"
    )
    rate_hz: float = Field(10.0, gt=0, le=10_000, description="error frames per second [Hz]")


class BusOff(Fault):
    """The CAN hardware takes itself off the bus: one error frame, nothing at all, one that says restarted."""

    kind: Literal["bus_off"] = "bus_off"


class Flood(Fault):
    """A babbling node: without an identifier it repeats the last displacement frame, else it sends zeros."""

    kind: Literal["flood"] = "flood"
    rate_hz: float = Field(1000.0, gt=0, le=20_000, description="frames per second [Hz]")
    arbitration_id: int | None = Field(
        None, ge=0, le=0x7FF, description="identifier of 11 bits; left out: that of the displacement frame"
    )


class InterfaceDown(Fault):
    """The network interface is set down."""

    kind: Literal["interface_down"] = "interface_down"


class InterfaceDeleted(Fault):
    """The CAN adapter is pulled out: its interface is gone."""

    kind: Literal["interface_deleted"] = "interface_deleted"


PartFault = BrownOut | RepeatedSamples | SelfTestFailure | WrongProductId | Unplugged | Replaced | Overrange
WireFault = MisoLow | MisoHigh | BitFlips | SpiErrors | SlowSpi
EdgeFault = DataReadyLost | DataReadyDoubled | LateEdges
SerialFault = SerialCut | SerialDrops | SerialFlips | SerialGarbage | SerialHeaps | AdapterGone
Jy901Fault = Jy901BrownOut | Jy901Frozen | Jy901DeadBand
ValueFault = StuckValue | Jump | Drift | NoiseBurst | SensorError | Delayed
FrameFault = CanSilence | WrongIdentifier | WrongLength | Corrupted | FrozenFrame
BusFault = ErrorFrames | BusOff | Flood
InterfaceFault = InterfaceDown | InterfaceDeleted

AnyFault = (
    PartFault | WireFault | EdgeFault | SerialFault | Jy901Fault | ValueFault | FrameFault | BusFault | InterfaceFault
)


class FaultScript(BaseModel):
    """Faults that may overlap, in any order."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: int = Field(1, ge=0, description="seed of everything random in the script")
    fault: tuple[Annotated[AnyFault, Field(discriminator="kind")], ...] = Field(
        (), description="the faults, a table [[fault]] each"
    )

    @property
    def in_order(self) -> list[AnyFault]:
        """The faults in order of time."""
        return sorted(self.fault, key=lambda fault: fault.at_s)


F = TypeVar("F", bound=Fault)


@dataclass(slots=True, frozen=True)
class Placed(Generic[F]):
    """A fault at its place in the time of a run, with randomness of its own."""

    fault: F
    start_ns: int
    end_ns: int
    key: bytes

    def holds(self, t_ns: int) -> bool:
        """Whether the fault lasts at `t_ns`."""
        return self.start_ns <= t_ns < self.end_ns

    def generator(self) -> random.Random:
        """For a sequence of draws that always come in the same order."""
        return random.Random(self.key)

    def draw(self, t_ns: int) -> float:
        """A number in [0, 1) that belongs to `t_ns`: the same however often and in whatever order it is asked."""
        digest = hashlib.blake2b(struct.pack(">q", t_ns - self.start_ns), digest_size=7, key=self.key).digest()
        return int.from_bytes(digest, "big") / (1 << 56)


def placed(script: FaultScript, start_ns: int, *kinds: type[F]) -> list[Placed[F]]:
    """The faults of these kinds for a run that starts at `start_ns`, in the order of the script."""
    return [
        Placed(
            fault,
            start_ns + round(fault.at_s * 1e9),
            start_ns + round((fault.at_s + fault.for_s) * 1e9),
            f"{script.seed}/{number}".encode(),
        )
        for number, fault in enumerate(script.fault)
        if isinstance(fault, kinds)
    ]


KINDS: dict[str, type[Fault]] = {
    kind.model_fields["kind"].default: kind
    for kind in (
        *(MisoLow, MisoHigh, BitFlips, BrownOut, DataReadyLost, DataReadyDoubled, SpiErrors, SlowSpi),
        *(RepeatedSamples, SelfTestFailure, WrongProductId, Unplugged, Replaced, Overrange, LateEdges),
        *(SerialCut, SerialDrops, SerialFlips, SerialGarbage, SerialHeaps, AdapterGone),
        *(Jy901BrownOut, Jy901Frozen, Jy901DeadBand),
        *(CanSilence, StuckValue, Jump, Drift, NoiseBurst, SensorError, Delayed, WrongIdentifier, WrongLength),
        *(Corrupted, FrozenFrame, ErrorFrames, BusOff, Flood, InterfaceDown, InterfaceDeleted),
    )
}
