from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.displacement import DisplacementDecoder
from drivers.can.frame import Frame, FrameId
from drivers.can.presets import PRESETS
from drivers.can.settings import DisplacementSettings
from drivers.virtual.controller import (
    LABORATORY_SENSOR,
    FloatArray,
    ObservedDisplacement,
    SensorParameters,
    VirtualController,
    exact_observations,
)
from estimation.records import ReadingFault
from tests.drivers.can_kit import about, status


def push(duration_s: float = 60.0) -> tuple[FloatArray, FloatArray]:
    """Rest 10 s, then 14.53 mm/s up to 500 mm."""
    t_s = np.arange(0.0, duration_s, 0.01)
    return t_s, np.clip((t_s - 10.0) * 0.01453, 0.0, 0.5)


def sensor(seed: int = 1, **parameters: Any) -> ObservedDisplacement:
    return ObservedDisplacement(SensorParameters(**parameters), np.random.default_rng(seed))


def test_perfect_sensor_shows_whole_millimetres_of_the_truth_at_its_rate() -> None:
    t_s, truth = push()
    readings = sensor(rate_hz=20.0).observations(t_s, truth)
    assert len(readings) == 1200
    taken_s = np.array([t_ns for t_ns, _ in readings]) / 1e9
    assert np.allclose(np.diff(taken_s), 0.05)
    assert 0.0 <= taken_s[0] < 0.05
    shown = np.array([value for _, value in readings])
    assert np.abs(shown - np.interp(taken_s, t_s, truth)).max() <= 0.0005 + 1e-9
    assert np.allclose(shown * 1000, np.round(shown * 1000))


@pytest.mark.parametrize("short_mm", [5.0, 10.0, 14.75])
def test_oblique_sensor_is_right_at_the_start_and_short_by_the_given_amount_at_full_stroke(
    short_mm: float,
) -> None:
    oblique = sensor(short_at_full_stroke_m=short_mm / 1000)
    shown = oblique.shown(np.array([0.0, 0.25, 0.5]))
    assert shown[0] == about(0.0, abs=1e-12)
    assert shown[2] == about(0.5 - short_mm / 1000, abs=1e-9)
    # Between the ends the shape is that of a hypotenuse over 900 mm; h found here by bisection.
    low, high = 0.0, 1.0
    for _ in range(60):
        h = (low + high) / 2
        full = math.hypot(1.4, h) - math.hypot(0.9, h)
        low, high = (low, h) if 0.5 - full > short_mm / 1000 else (h, high)
    assert shown[1] == about(math.hypot(1.15, low) - math.hypot(0.9, low), abs=1e-9)


def test_reading_is_as_old_as_the_latency_when_its_frame_is_sent() -> None:
    t_s = np.arange(0.0, 10.0, 0.001)
    readings = sensor(latency_s=0.03, resolution_m=1e-7).observations(t_s, 0.1 * t_s)
    assert [value for _, value in readings] == about([0.1 * (t_ns / 1e9 - 0.03) for t_ns, _ in readings], abs=1e-6)


def test_noise_and_offset_are_those_asked_for() -> None:
    t_s = np.arange(0.0, 400.0, 0.1)
    readings = sensor(rate_hz=20.0, sigma_m=0.004, offset_m=0.0015).observations(t_s, np.full(t_s.size, 0.2))
    error = np.array([value for _, value in readings]) - 0.2
    count = error.size
    assert error.mean() == about(0.0015, abs=4 * 0.004 / math.sqrt(count))
    assert error.std() == about(math.hypot(0.004, 0.001 / math.sqrt(12)), rel=4 / math.sqrt(2 * count))


def test_drop_outs_leave_gaps_of_the_given_length_and_frequency() -> None:
    t_s = np.arange(0.0, 5000.0, 0.5)
    dropping = sensor(rate_hz=20.0, dropouts_per_s=0.02)
    readings = dropping.observations(t_s, np.zeros(t_s.size))
    gaps = np.diff([t_ns for t_ns, _ in readings]) / 1e9
    holes = gaps[gaps > 0.06]
    # Poisson, mean 100; two drop-outs may run together.
    assert 70 <= holes.size <= 130
    assert holes.max() <= 2.1
    assert holes.min() >= 0.15
    assert np.allclose(gaps * 20, np.round(gaps * 20), atol=1e-4)


def test_pieces_of_a_motion_give_the_readings_of_the_whole() -> None:
    t_s, truth = push()
    whole = sensor(short_at_full_stroke_m=0.01).observations(t_s, truth)
    piecewise = sensor(short_at_full_stroke_m=0.01)
    pieces = [
        reading
        for part in np.array_split(np.arange(t_s.size), 37)
        for reading in piecewise.observations(t_s[part], truth[part])
    ]
    assert [t_ns for t_ns, _ in pieces] == [t_ns for t_ns, _ in whole]
    assert [value for _, value in pieces] == about([value for _, value in whole], abs=0.0011)


def test_drop_out_goes_on_into_the_next_piece() -> None:
    dropping = sensor(rate_hz=20.0, dropouts_per_s=1e3, dropout_s=(10.0, 10.0))
    t_s = np.arange(0.0, 1.0, 0.01)
    dropping.observations(t_s, np.zeros(t_s.size))
    assert dropping.observations(t_s + 1.0, np.zeros(t_s.size)) == []


def test_same_seed_gives_the_same_readings_and_another_seed_others() -> None:
    def readings(seed: int) -> list[tuple[int, float]]:
        rng = np.random.default_rng(seed)
        return ObservedDisplacement(SensorParameters.draw(rng), rng).observations(*push())

    assert readings(5) == readings(5)
    assert readings(5) != readings(6)


def test_drawn_sensors_stay_within_their_distributions() -> None:
    rng = np.random.default_rng(1)
    drawn = [SensorParameters.draw(rng) for _ in range(400)]
    for name, low, high in (
        ("rate_hz", 10.0, 20.0),
        ("sigma_m", 0.002, 0.005),
        ("short_at_full_stroke_m", 0.005, 0.01475),
        ("latency_s", 0.005, 0.030),
    ):
        values = np.array([getattr(parameters, name) for parameters in drawn])
        assert low <= values.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values.max() <= high
    offsets = np.array([parameters.offset_m for parameters in drawn])
    assert offsets.std() == about(0.0015, rel=0.15)
    assert {(parameters.resolution_m, parameters.dropouts_per_s) for parameters in drawn} == {(0.001, 0.02)}


def test_laboratory_sensor_is_exact_to_a_hundredth_of_a_millimetre() -> None:
    t_s, truth = push()
    readings = exact_observations(t_s, truth)
    assert len(readings) == 3000
    errors = [value - np.interp(t_ns / 1e9, t_s, truth) for t_ns, value in readings]
    assert np.abs(errors).max() <= 0.5e-5 + 1e-9


UNINTENDED = {ReadingFault.MALFORMED, ReadingFault.CHECKSUM, ReadingFault.REPEATED}


def decode_all(settings: DisplacementSettings, frames: list[Frame]) -> list[tuple[int, float, bool]]:
    decoder = DisplacementDecoder(settings)
    readings = [decoder.decode(frame) for frame in frames]
    assert (decoder.report(0).lost_frames, UNINTENDED & {f for f, n in decoder.faults.items() if n}) == (0, set())
    return [(reading.t_ns, reading.value_m, reading.valid) for reading in readings if reading]


@settings(derandomize=True, deadline=None)
@given(preset=st.sampled_from(sorted(PRESETS)), values_mm=st.lists(st.integers(0, 900), max_size=20))
def test_what_the_controller_sends_is_what_the_decoder_reads(preset: Any, values_mm: list[int]) -> None:
    options = DisplacementSettings(preset=preset)
    readings = [(100 * index, value / 1000) for index, value in enumerate(values_mm)]
    frames = VirtualController(readings, options).due(10**9)
    assert decode_all(options, frames) == [(t_ns, about(value, abs=1e-9), True) for t_ns, value in readings]


def test_counter_of_the_support_controller_goes_from_0_to_15_and_over() -> None:
    frames = VirtualController([(index, 0.1) for index in range(18)]).due(100)
    assert [frame.data for frame in frames] == [status(100, number % 16) for number in range(18)]


def test_frames_come_when_due_and_only_once() -> None:
    controller = VirtualController([(10, 0.1), (20, 0.2), (30, 0.3)])
    assert controller.next_t_ns == 10
    assert controller.due(9) == []
    assert [frame.t_ns for frame in controller.due(20)] == [10, 20]
    assert controller.due(20) == []
    assert controller.next_t_ns == 30
    assert [frame.t_ns for frame in controller.due(1000)] == [30]
    assert controller.next_t_ns is None
    assert controller.due(2000) == []


def test_endless_observations_are_taken_only_as_far_as_due() -> None:
    controller = VirtualController((t_ns, 0.1) for t_ns in itertools.count(0, 10))
    assert len(controller.due(95)) == 10


def test_reference_frames_are_merged_in_order_of_time() -> None:
    controller = VirtualController([(10, 0.3), (30, 0.3)], reference=[(5, 0.34712), (25, -0.00001)])
    frames = controller.due(100)
    assert [(frame.t_ns, frame.arbitration_id) for frame in frames] == [
        (5, 0x311),
        (10, 0x310),
        (25, 0x311),
        (30, 0x310),
    ]
    assert decode_all(LABORATORY_SENSOR, frames) == [
        (5, about(0.34712, abs=1e-9), True),
        (25, about(-0.00001, abs=1e-9), True),
    ]


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_sensor_that_knows_it_is_ill_is_never_read_as_valid(preset: Any) -> None:
    options = DisplacementSettings(preset=preset)
    readings = [(10, 0.2), (20, math.nan), (30, math.nan), (40, 0.3)]
    frames = VirtualController(readings, options).due(100)
    assert [(t_ns, valid) for t_ns, _, valid in decode_all(options, frames)] == [
        (10, True),
        (20, False),
        (30, False),
        (40, True),
    ]


def test_sensor_without_a_validity_signal_goes_out_of_range_when_ill() -> None:
    frames = VirtualController([], reference=[(10, math.nan)]).due(100)
    ((_, value_m, valid),) = decode_all(LABORATORY_SENSOR, frames)
    assert value_m > 1000
    assert not valid


def test_canopen_sensor_that_lost_its_magnet_repeats_its_position_and_sends_emergencies() -> None:
    options = DisplacementSettings(preset="cia406", node_id=3)
    frames = VirtualController([(10, 0.2), (20, math.nan), (30, math.nan), (40, 0.3)], options).due(100)
    assert [frame.arbitration_id for frame in frames] == [0x183, 0x083, 0x183, 0x183, 0x083, 0x183]
    assert frames[1].data == bytes.fromhex("0050010000000000")
    assert frames[4].data == bytes(8)
    assert frames[2].data == frames[3].data == frames[0].data


def test_value_beyond_the_signal_is_clipped_not_wrapped() -> None:
    options = DisplacementSettings(preset="j1939_proprietary_b")
    frames = VirtualController([(1, -0.01), (2, 10.0)], options).due(100)
    assert [value for _, value, _ in decode_all(options, frames)] == [
        0.0,
        about(6.5023),
    ]  # the codes above mean "error"


def test_own_dbc_file_can_be_spoken_too(tmp_path: Path) -> None:
    path = tmp_path / "own.dbc"
    path.write_text('VERSION ""\nBU_: A\nBO_ 291 Own: 8 A\n SG_ Stroke : 7|16@0+ (0.5,-100) [0|0] "mm" A\n')
    options = DisplacementSettings(dbc=path, message="Own", signal="Stroke", arbitration_id=0x124)
    frames = VirtualController([(1, 0.1235)], options).due(100)
    assert frames[0].frame_id == FrameId(0x124)
    assert frames[0].data == (447).to_bytes(2, "big") + bytes(6)  # (123.5 + 100) / 0.5


def test_message_of_more_than_eight_bytes_goes_out_as_a_padded_fd_frame_with_counter_and_checksum(
    tmp_path: Path,
) -> None:
    path = tmp_path / "fd.dbc"
    path.write_text(
        'VERSION ""\nBU_: A\nBO_ 291 Long: 21 A\n SG_ Stroke : 96|16@1+ (1,0) [0|0] "mm" A\n'
        ' SG_ Count : 160|4@1+ (1,0) [1|14] "" A\n SG_ Sum : 0|8@1+ (1,0) [0|255] "" A\n'
    )
    options = DisplacementSettings(
        dbc=path, message="Long", signal="Stroke", counter_signal="Count", checksum_signal="Sum", checksum="sum8"
    )
    frames = VirtualController([(index, 0.3) for index in range(30)], options).due(100)
    assert {(frame.is_fd, len(frame.data)) for frame in frames} == {(True, 24)}
    assert [frame.data[20] for frame in frames[:16]] == [*range(1, 15), 1, 2]
    assert [frame.data[0] for frame in frames] == [sum(frame.data[1:]) % 256 for frame in frames]
    assert decode_all(options, frames) == [(index, 0.3, True) for index in range(30)]
