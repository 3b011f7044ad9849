"""Settings of the estimator: how the sensor is mounted, what the support can do, what is assumed of it."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

SignedAxis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


class Settings(BaseModel):
    """Base of all settings here: unknown keys are refused, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class AxesSettings(Settings):
    """Which way a sensor's axes look."""

    push: SignedAxis = Field("+y", description="sensor axis that points in the direction of the push")
    up: SignedAxis = Field("+z", description="sensor axis that points up, another one than `push`")
    pitch_deg: float = Field(
        0.0,
        ge=-45,
        le=45,
        description="how far these axes are tilted about the axis across, as `align` finds on level ground [deg]; "
        "taken off before anything else",
    )
    roll_deg: float = Field(0.0, ge=-45, le=45, description="the same about the push axis [deg]")

    @model_validator(mode="after")
    def _axes_differ(self) -> Self:
        if self.push[1] == self.up[1]:
            raise ValueError(f"push = {self.push!r} and up = {self.up!r} lie on the same axis; name two axes")
        return self


class MountSettings(AxesSettings):
    """Which way the inertial sensor's axes look, and on which part of the support it sits."""

    heading_deg: float | None = Field(
        None,
        ge=-360,
        le=360,
        description="of the push, counter-clockwise from north, from the survey or from `align` [deg]; the estimate "
        "needs none, `align` takes it as known",
    )
    imu_on: Literal["both", "link", "base"] = Field(
        "both",
        description="what carries the sensor: `link` feels only the push, `base` only the advance, "
        "`both` (cylinder on a test bench) feels both",
    )


class SupportSettings(Settings):
    """The hydraulic powered roof support."""

    stroke_mm: float = Field(500.0, ge=50, le=2000, description="full stroke between the mechanical stops [mm]")
    nominal_push_speed_mm_s: float = Field(14.53, ge=2, le=200, description="usual speed of a push [mm/s]")
    nominal_retract_speed_mm_s: float = Field(35.19, ge=2, le=200, description="usual speed of a retract [mm/s]")
    initial_mm: float | None = Field(
        None,
        ge=0,
        description="stroke at the start of an imported recording [mm], at most stroke_mm; 0 if not given; "
        "`run` takes it from the controller, else from the saved state, else calls it undetermined",
    )

    @model_validator(mode="after")
    def _initial_within_stroke(self) -> Self:
        if self.initial_mm is not None and self.initial_mm > self.stroke_mm:
            raise ValueError(f"initial_mm = {self.initial_mm:g} lies beyond stroke_mm = {self.stroke_mm:g}")
        return self


class TwoStateSettings(Settings):
    """Covariances of paper A's two-state filter, for `--method kf2-tuned`; `ramstroke tune --save` writes them."""

    q: float = Field(
        0.88,
        gt=0,
        description="process noise: variance of the acceleration [(m/s²)²] with `BqB`; with `qI` of position and speed "
        "per sample [m², (m/s)²]",
    )
    r: float = Field(2.2e-5, gt=0, description="variance of a reading of the displacement [m²]")
    form: Literal["BqB", "qI"] = Field(
        "BqB", description="how q enters the covariance: q B Bᵀ, or q I as eq. (2) of paper A reads literally"
    )


class EstimatorSettings(Settings):
    """What the estimator assumes before it has seen anything; all sigmas are one standard deviation."""

    speed_sigma_machine: float = Field(
        0.02,
        gt=0,
        le=0.5,
        description="how far one support's usual speed lies from nominal, as a share of it",
    )
    speed_sigma_cycle: float = Field(
        0.015,
        gt=0,
        le=0.5,
        description="how far one move's speed lies from the support's usual one, as a share",
    )
    speed_wander: float = Field(
        0.01,
        gt=0,
        le=0.5,
        description="how far the speed wanders from its mean within one move (over 2.5 s), as a share",
    )
    can_noise_mm: float = Field(
        3.5,
        gt=0,
        le=50,
        description="noise of the observed displacement at the start [mm]; learned from the data",
    )
    can_offset_sigma_mm: float = Field(1.5, gt=0, le=100, description="offset of the observed displacement [mm]")
    can_scale: float = Field(
        -0.015,
        ge=-0.5,
        le=0.5,
        description="scale error of the observed displacement to expect before calibration, as a share; negative "
        "because a sensor that lies oblique to the push reads short: by up to 15 mm of 500, so half of that",
    )
    can_scale_sigma: float = Field(
        0.010, gt=0, le=0.5, description="how far the scale error may lie from that, as a share"
    )
    can_curvature_sigma_mm: float = Field(
        1.2, gt=0, le=50, description="bow of the observed displacement at half stroke [mm]"
    )
    can_latency_sigma_ms: float = Field(
        8.0, gt=0, le=500, description="how far the age of a reading may lie from `can.displacement.latency_ms` [ms]"
    )
    stop_constraint: bool = Field(
        True,
        description="use the mechanical stops as a measurement where there is evidence that one was reached",
    )
    stop_sigma_mm: float = Field(0.6, gt=0, le=20, description="scatter of the mechanical stops [mm]")
