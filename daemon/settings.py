"""All settings of the program: one TOML file, every key optional, composed from the models of the parts."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from daemon.recording.settings import RecorderSettings
from drivers.adis16448.configuration import ImuSettings
from drivers.can.settings import CanSettings
from drivers.jy901.settings import Jy901Settings
from estimation.settings import AxesSettings, EstimatorSettings, MountSettings, SupportSettings, TwoStateSettings


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ServiceSettings(_Section):
    """The running daemon itself."""

    socket: Path = Field(Path("/run/ramstroke/live.sock"), description="Unix socket that `status` and viewers read")
    state_file: Path = Field(
        Path("/var/lib/ramstroke/state.json"),
        description="where the stroke, and what was learned of support and displacement sensor, outlast a restart",
    )


class SimulationSettings(_Section):
    """The virtual support of `sim`, of `demo` and of the transport `virtual`."""

    seed: int = Field(1, ge=0, description="seed of machine, sensors and noise")
    scenario: Literal["nominal", "lab_bench"] = Field("nominal", description="how much it shakes and tilts")
    reference: bool = Field(True, description="let a laboratory sensor send its frames on CAN too")


class Jy901MountSettings(AxesSettings):
    """Which way the axes of a JY901 recorded beside the ADIS16448 look; in its place it is `[mount]` that counts."""


class Settings(_Section):
    """The whole configuration file."""

    imu: ImuSettings = Field(default_factory=ImuSettings)
    jy901: Jy901Settings = Field(default_factory=Jy901Settings)
    jy901_mount: Jy901MountSettings = Field(default_factory=Jy901MountSettings)
    can: CanSettings = Field(default_factory=CanSettings)
    mount: MountSettings = Field(default_factory=MountSettings)
    support: SupportSettings = Field(default_factory=SupportSettings)
    estimator: EstimatorSettings = Field(default_factory=EstimatorSettings)
    two_state: TwoStateSettings = Field(default_factory=TwoStateSettings)
    recording: RecorderSettings = Field(default_factory=RecorderSettings)
    service: ServiceSettings = Field(default_factory=ServiceSettings)
    simulation: SimulationSettings = Field(default_factory=SimulationSettings)

    @model_validator(mode="after")
    def _virtual_parts_belong_together(self) -> Self:
        key, real, is_real = "imu.transport", "spidev", self.imu.transport == "spidev"
        if self.jy901.use == "instead":
            key, real, is_real = "jy901.transport", "serial", self.jy901.transport == "serial"
        if is_real and self.can.enabled and self.can.interface == "virtual":
            raise ValueError(
                'can.interface = "virtual" exists only within one process: '
                f'with {key} = "{real}" choose "socketcan", or set can.enabled = false'
            )
        return self

    @property
    def needs_support(self) -> bool:
        """Whether a sensor is a virtual one of this process."""
        main = self.jy901.use != "instead" and self.imu.transport == "virtual"
        return main or (self.jy901.use != "no" and self.jy901.transport == "virtual")

    @property
    def nominal_rate_hz(self) -> float:
        """Samples a second of the sensor that the estimate comes from."""
        return self.jy901.rate_hz if self.jy901.use == "instead" else self.imu.nominal_rate_hz
