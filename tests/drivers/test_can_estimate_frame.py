from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import cantools.database
import pytest
from crccheck.crc import Crc8SaeJ1850  # type: ignore[import-untyped]  # has no annotations
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.can.checksums import crc8_j1850
from drivers.can.estimate_frame import EstimateEncoder, decode_estimate
from drivers.can.frame import Frame
from drivers.can.presets import DBC_FOLDER
from drivers.can.settings import PublishSettings
from estimation.records import CanState, Estimate, Segment, Tier

DATABASE: Any = cantools.database.load_file(DBC_FOLDER / "ramstroke_estimate.dbc")
DBC = DATABASE.get_message_by_name("RamstrokeEstimate")
NAN = math.nan
ESTIMATE = Estimate(
    t_ns=99,
    displacement_m=0.3472,
    sigma_m=0.0012,
    velocity_m_s=-0.0352,
    velocity_sigma_m_s=0.001,
    segment=Segment.CVS,
    tier=Tier.SETTLED,
    can_state=CanState.BIASED,
    move=3,
    acceleration_m_s2=0.0,
    chart_lower_m_s2=0.0,
    chart_upper_m_s2=0.0,
    step_m_s=0.0,
    innovation_m=NAN,
    gate_m=NAN,
)


def encode(estimate: Estimate) -> Frame:
    return EstimateEncoder(PublishSettings()).encode(estimate)


def test_default_identifier_is_that_of_the_dbc_file() -> None:
    frame = encode(ESTIMATE)
    assert (frame.arbitration_id, frame.is_extended) == (DBC.frame_id, DBC.is_extended_frame)
    assert (frame.t_ns, len(frame.data), frame.is_fd) == (99, DBC.length, False)


def test_identifier_of_the_users_choice_is_used() -> None:
    frame = EstimateEncoder(PublishSettings(arbitration_id=0x18FFAA01, extended=True)).encode(ESTIMATE)
    assert (frame.arbitration_id, frame.is_extended) == (0x18FFAA01, True)


def test_frame_read_with_the_dbc_file_tells_the_estimate() -> None:
    values = DBC.decode(encode(ESTIMATE).data)
    assert values["displacement"] == pytest.approx(347.2)
    assert values["velocity"] == pytest.approx(-35.2)
    assert values["sigma"] == pytest.approx(1.2)
    assert [str(values[name]) for name in ("segment", "tier", "sensor_state")] == ["CVS", "settled", "biased"]


@pytest.mark.parametrize("segment", list(Segment))
@pytest.mark.parametrize("tier", list(Tier))
@pytest.mark.parametrize("can_state", list(CanState))
def test_every_state_has_the_same_name_in_the_dbc_file(segment: Segment, tier: Tier, can_state: CanState) -> None:
    frame = encode(replace(ESTIMATE, segment=segment, tier=tier, can_state=can_state))
    values = DBC.decode(frame.data)
    assert [str(values[name]) for name in ("segment", "tier", "sensor_state")] == [segment, tier, can_state]
    received = decode_estimate(frame)
    assert (received.segment, received.tier, received.can_state) == (segment, tier, can_state)


def test_counter_goes_from_0_to_15_and_over() -> None:
    encoder = EstimateEncoder(PublishSettings())
    counters = [DBC.decode(encoder.encode(ESTIMATE).data)["counter"] for _ in range(18)]
    assert counters == [*range(16), 0, 1]


def test_crc_gives_the_published_check_value() -> None:
    assert crc8_j1850(b"123456789") == 0x4B


@settings(derandomize=True, deadline=None)
@given(st.binary(max_size=16))
def test_crc_agrees_with_an_independent_implementation(data: bytes) -> None:
    assert crc8_j1850(data) == Crc8SaeJ1850.calc(data)


any_float = st.floats() | st.floats(-0.7, 0.7)


def expected_tenths(value_si: float, lowest: float, highest: float) -> float:
    return max(lowest, min(highest, value_si * 10_000))


@settings(derandomize=True, deadline=None, max_examples=300)
@given(any_float, any_float, any_float)
@example(math.inf, -math.inf, math.inf)
@example(NAN, NAN, NAN)
@example(0.5, 0.0, -1.0)
def test_values_saturate_and_nan_becomes_undetermined(displacement: float, velocity: float, sigma: float) -> None:
    frame = encode(replace(ESTIMATE, displacement_m=displacement, velocity_m_s=velocity, sigma_m=sigma))
    raw = DBC.decode(frame.data, scaling=False, decode_choices=False)
    received = decode_estimate(frame)
    for sent, name, got in (
        (displacement, "displacement", received.displacement_m),
        (velocity, "velocity", received.velocity_m_s),
    ):
        if math.isnan(sent):
            assert raw[name] == -0x8000
            assert math.isnan(got)
        else:
            assert abs(raw[name] - expected_tenths(sent, -0x7FFF, 0x7FFF)) <= 0.5
            assert got == pytest.approx(raw[name] / 10_000)
    if math.isnan(sigma):
        assert raw["sigma"] == 0xFFF
        assert math.isnan(received.sigma_m)
    else:
        # Never smaller than the true one, unless saturated.
        assert -1e-6 <= raw["sigma"] - expected_tenths(sigma, 0, 0xFFE) < 1
        assert received.sigma_m == pytest.approx(raw["sigma"] / 10_000)


@pytest.mark.parametrize("bit", range(64))
def test_any_flipped_bit_is_noticed(bit: int) -> None:
    damaged = (int.from_bytes(encode(ESTIMATE).data, "little") ^ 1 << bit).to_bytes(8, "little")
    with pytest.raises(ValueError, match="CRC"):
        decode_estimate(Frame(1, 0x6F0, damaged))


@pytest.mark.parametrize("data", [bytes(8), b"\xff" * 8])
def test_all_zeros_and_all_ones_are_no_estimate(data: bytes) -> None:
    with pytest.raises(ValueError, match="CRC"):
        decode_estimate(Frame(1, 0x6F0, data))


def test_wrong_length_and_undefined_codes_are_refused() -> None:
    with pytest.raises(ValueError, match="7 bytes instead of 8"):
        decode_estimate(Frame(1, 0x6F0, bytes(7)))
    for body in (bytes.fromhex("00000000003000"), bytes.fromhex("00000000000008")):
        with pytest.raises(ValueError, match="not defined"):
            decode_estimate(Frame(1, 0x6F0, body + bytes([crc8_j1850(body)])))
