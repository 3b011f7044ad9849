from __future__ import annotations

from itertools import product
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from estimation.alignment.attitude import from_angles
from estimation.mount.axes import Mount
from estimation.settings import MountSettings, SignedAxis, SupportSettings

AXES: tuple[SignedAxis, ...] = get_args(SignedAxis)
PAIRS = [(push, up) for push, up in product(AXES, AXES) if push[1] != up[1]]


def direction(axis: SignedAxis) -> tuple[float, float, float]:
    x, y, z = ((1.0 if axis[0] == "+" else -1.0) * (name == axis[1]) for name in "xyz")
    return (x, y, z)


def test_there_are_24_ways_to_mount_the_sensor() -> None:
    assert len(PAIRS) == 24


@pytest.mark.parametrize(("push", "up"), PAIRS)
def test_every_mount_is_a_proper_rotation_with_push_along_y_and_up_along_z(push: SignedAxis, up: SignedAxis) -> None:
    mount = Mount(MountSettings(push=push, up=up))
    r = np.array([mount.to_support(direction(axis)) for axis in ("+x", "+y", "+z")]).T
    assert np.array_equal(r @ r.T, np.eye(3))
    assert np.linalg.det(r) == pytest.approx(1.0)
    assert mount.to_support(direction(push)) == (0.0, 1.0, 0.0)
    assert mount.to_support(direction(up)) == (0.0, 0.0, 1.0)
    v = (0.1, -0.2, 0.3)
    np.testing.assert_array_equal(mount.to_support(v), r @ v)


@pytest.mark.parametrize(("push", "up"), [("+y", "+y"), ("-x", "+x")])
def test_push_and_up_on_one_axis_are_refused(push: SignedAxis, up: SignedAxis) -> None:
    with pytest.raises(ValidationError, match="name two axes"):
        MountSettings(push=push, up=up)


def test_initial_stroke_beyond_the_stroke_is_refused() -> None:
    assert SupportSettings(stroke_mm=400, initial_mm=400).initial_mm == 400
    with pytest.raises(ValidationError, match="initial_mm = 500 lies beyond stroke_mm = 400"):
        SupportSettings(stroke_mm=400, initial_mm=500)


@given(st.floats(-45, 45), st.floats(-45, 45), st.sampled_from(PAIRS))
def test_a_tilt_is_taken_off(pitch_deg: float, roll_deg: float, axes: tuple[SignedAxis, SignedAxis]) -> None:
    """The attitude at heading 0, by the alignment's own matrices."""
    push, up = axes
    nominal = Mount(MountSettings(push=push, up=up))
    tilted = Mount(MountSettings(push=push, up=up, pitch_deg=pitch_deg, roll_deg=roll_deg))
    attitude = from_angles(*(np.radians(np.array(one)) for one in (pitch_deg, roll_deg, 0.0)))
    v = (0.3, -9.0, 2.0)
    np.testing.assert_allclose(tilted.to_support(v), attitude @ nominal.to_support(v), atol=1e-14)
    same = Mount(MountSettings(push=push, up=up, pitch_deg=pitch_deg, roll_deg=roll_deg), with_tilt=False)
    assert same.to_support(v) == nominal.to_support(v)
