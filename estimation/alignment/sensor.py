"""How good an inertial sensor is, in the units of its data sheet."""

from __future__ import annotations

from math import radians, sqrt

from pydantic import BaseModel, ConfigDict, Field

G_M_S2 = 9.80665


class SensorGrade(BaseModel):
    """Biases (one sigma) and white noise."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    gyro_bias_deg_h: float = Field(ge=0, description="bias of a gyroscope [deg/h]")
    angle_walk_deg_sqrt_h: float = Field(ge=0, description="angle random walk [deg/sqrt(h)]")
    accel_bias_mg: float = Field(ge=0, description="bias of an accelerometer [mg]")
    velocity_walk_m_s_sqrt_h: float = Field(ge=0, description="velocity random walk [m/s/sqrt(h)]")
    source: str = Field("", description="where the figures are from")

    @property
    def gyro_bias(self) -> float:
        """[rad/s]."""
        return radians(self.gyro_bias_deg_h) / 3600

    @property
    def angle_walk(self) -> float:
        """[rad/sqrt(s)]."""
        return radians(self.angle_walk_deg_sqrt_h) / 60

    @property
    def accel_bias(self) -> float:
        """[m/s^2]."""
        return self.accel_bias_mg * 1e-3 * G_M_S2

    @property
    def velocity_walk(self) -> float:
        """[m/s/sqrt(s)]."""
        return self.velocity_walk_m_s_sqrt_h / sqrt(3600)
