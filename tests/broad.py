"""The real recording of `tests/data/broad`: another sensor, moved by hand, with an optical reference."""

from __future__ import annotations

import csv
import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

SLICE = Path(__file__).parent / "data" / "broad" / "slow_translation_34_54_s.csv.gz"
MOTION = ("gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s", "accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2")


@dataclass(frozen=True)
class RealRecording:
    """Arrays of n rows; the reference is NaN where the cameras lost the marker."""

    t_s: list[str]  # as written in the file: the nanoseconds must survive
    motion: NDArray[np.float64]  # (n, 6) gyro [rad/s], accel [m/s^2]
    position_m: NDArray[np.float64]  # (n, 3) east, north, up
    orientation: NDArray[np.float64]  # (n, 4) w x y z, sensor to east-north-up
    moving: NDArray[np.bool_]

    def reference_mm(self, axis: int) -> NDArray[np.float64]:
        """Way along the direction that a sensor axis had at the beginning, from there (n,)."""
        known = np.flatnonzero(~np.isnan(self.orientation).any(axis=1) & ~np.isnan(self.position_m).any(axis=1))[0]
        w, x, y, z = self.orientation[known]
        direction = Rotation.from_quat([x, y, z, w]).apply(np.eye(3)[axis])
        return np.asarray((self.position_m - self.position_m[known]) @ direction * 1e3)

    def write_table(self, path: Path, axis: int = 1) -> None:
        """The table that `ramstroke import` takes."""
        with path.open("w", newline="") as stream:
            rows = csv.writer(stream)
            rows.writerow(["t_s", *MOTION, "reference_mm"])
            for t, motion, reference in zip(self.t_s, self.motion, self.reference_mm(axis), strict=True):
                rows.writerow([t, *map(repr, motion.tolist()), "" if np.isnan(reference) else f"{reference:.3f}"])


def load(path: Path = SLICE) -> RealRecording:
    """Read the slice, or the whole published file."""
    with gzip.open(path, "rt") as stream:
        rows = list(csv.DictReader(stream))

    def columns(*names: str) -> NDArray[np.float64]:
        return np.array([[float(row[name] or "nan") for name in names] for row in rows])

    return RealRecording(
        t_s=[row["t_s"] for row in rows],
        motion=columns(*MOTION),
        position_m=columns("ref_x_m", "ref_y_m", "ref_z_m"),
        orientation=columns("ref_qw", "ref_qx", "ref_qy", "ref_qz"),
        moving=np.array([row["moving"] == "1" for row in rows]),
    )
