"""Faults of the displacement sensor, the controller's frames and the bus, frame by frame against a healthy run."""

from __future__ import annotations

import math
import statistics
from typing import Any

import pytest

from drivers.can.displacement import DisplacementDecoder
from drivers.can.frame import Frame, FrameId
from drivers.can.settings import DisplacementSettings
from drivers.virtual.can_network import network
from drivers.virtual.controller import VirtualController
from drivers.virtual.faults import FaultScript
from drivers.virtual.faulty_controller import FaultyController
from drivers.virtual.faulty_values import faulty_observations
from estimation.records import Displacement, ReadingFault
from tests.drivers.fault_kit import fault, script

START_NS = 7_000_000_000
READING, LABORATORY = FrameId(0x310), FrameId(0x311)
PERIOD_NS = 50_000_000  # 20 frames a second, so that 10 s are 200
# A ram that moves at 10 mm/s, and a laboratory sensor that is in step.
OBSERVED = [(START_NS + i * PERIOD_NS, round(0.010 * i * PERIOD_NS / 1e9, 3)) for i in range(200)]
REFERENCE = [(t_ns + 1000, value) for t_ns, value in OBSERVED]


def source(faults: FaultScript, channel: str | None = None) -> FaultyController:
    controller = VirtualController(
        faulty_observations(OBSERVED, faults, START_NS), DisplacementSettings(), reference=REFERENCE
    )
    return FaultyController(
        controller,
        faults,
        START_NS,
        reading_id=READING,
        bystander_id=LABORATORY,
        network=None if channel is None else network(channel),
    )


def played(*faults: dict[str, Any], seed: int = 1) -> list[Frame]:
    return source(script(*faults, seed=seed)).due(1 << 62)


def healthy() -> list[Frame]:
    return VirtualController(OBSERVED, DisplacementSettings(), reference=REFERENCE).due(1 << 62)


def split(frames: list[Frame], start_s: float, end_s: float) -> tuple[list[Frame], list[Frame]]:
    """Frames within and outside a time."""
    within = [f for f in frames if start_s <= (f.t_ns - START_NS) / 1e9 < end_s]
    return within, [f for f in frames if f not in within]


def readings(frames: list[Frame]) -> list[Displacement]:
    decoder = DisplacementDecoder(DisplacementSettings())
    return [reading for frame in frames if (reading := decoder.decode(frame)) is not None]


def values_mm(frames: list[Frame]) -> list[float]:
    return [reading.value_m * 1e3 for reading in readings(frames)]


def of(frames: list[Frame], frame_id: FrameId) -> list[Frame]:
    return [frame for frame in frames if frame.frame_id == frame_id and not frame.is_error]


HEALTHY = healthy()
TRUE_MM = values_mm(HEALTHY)


def check_outside(frames: list[Frame], start_s: float, end_s: float) -> list[Frame]:
    """The frames within, after a look that nothing else has changed."""
    within, outside = split(frames, start_s, end_s)
    assert outside == split(HEALTHY, start_s, end_s)[1]
    assert of(within, LABORATORY) == of(split(HEALTHY, start_s, end_s)[0], LABORATORY)
    return within


def test_a_script_without_faults_changes_nothing() -> None:
    assert played() == HEALTHY
    assert len(HEALTHY) == 400


def test_a_silent_controller_sends_nothing_and_the_laboratory_sensor_goes_on() -> None:
    within = check_outside(played(fault("can_silence", 2.0, 3.0)), 2.0, 5.0)
    assert of(within, READING) == []
    assert len(within) == 60


def test_a_stuck_value_stays_at_its_beginning_while_the_frames_go_on() -> None:
    frames = played(fault("stuck_value", 2.0, 3.0))
    within = check_outside(frames, 2.0, 5.0)
    assert values_mm(within) == [TRUE_MM[40]] * 60
    assert {reading.fault for reading in readings(frames)} == {ReadingFault.NONE}


def test_a_jump_is_added_and_taken_away() -> None:
    frames = values_mm(played(fault("jump", 2.0, 3.0, offset_mm=-40.0)))
    assert frames == [value - 40 * (40 <= i < 100) for i, value in enumerate(TRUE_MM)]


def test_a_drift_grows_from_nothing() -> None:
    frames = values_mm(played(fault("drift", 2.0, 4.0, mm_s=5.0)))
    expected = [value + 5 * (i - 40) * 0.05 * (40 <= i < 120) for i, value in enumerate(TRUE_MM)]
    assert frames == pytest.approx(expected, abs=0.5 + 1e-6)  # whole millimetres


def test_noise_scatters_as_the_script_says() -> None:
    frames = played(fault("noise_burst", 0.0, 10.0, sigma_mm=15.0))
    errors = [value - true for value, true in zip(values_mm(frames), TRUE_MM, strict=True)]
    assert statistics.stdev(errors) == pytest.approx(15.0, rel=0.2)  # 200 values, four standard deviations
    assert abs(statistics.mean(errors)) < 4.5
    assert frames == played(fault("noise_burst", 0.0, 10.0, sigma_mm=15.0))
    assert frames != played(fault("noise_burst", 0.0, 10.0, sigma_mm=15.0), seed=2)


def test_a_sensor_that_knows_its_illness_says_so() -> None:
    frames = played(fault("sensor_error", 2.0, 3.0))
    check_outside(frames, 2.0, 5.0)
    assert [reading.fault for reading in readings(frames)] == [
        ReadingFault.INVALID if 40 <= i < 100 else ReadingFault.NONE for i in range(200)
    ]


def test_delayed_readings_keep_their_order_and_hold_up_what_follows() -> None:
    frames = of(played(fault("delayed", 2.0, 3.0, latency_ms=120.0)), READING)
    times = [frame.t_ns for frame in frames]
    expected = [t + 120_000_000 * (40 <= i < 100) for i, (t, _) in enumerate(OBSERVED)]
    expected[100:102] = [expected[99]] * 2
    assert times == expected == sorted(times)
    assert values_mm(frames) == TRUE_MM


def test_displacement_frames_get_another_identifier() -> None:
    within = check_outside(played(fault("wrong_identifier", 2.0, 3.0, arbitration_id=0x123)), 2.0, 5.0)
    moved = of(within, FrameId(0x123))
    assert of(within, READING) == []
    assert [(f.t_ns, f.data) for f in moved] == [(f.t_ns, f.data) for f in of(HEALTHY, READING)[40:100]]


@pytest.mark.parametrize("length", [0, 1, 8])
def test_displacement_frames_get_another_length(length: int) -> None:
    within = check_outside(played(fault("wrong_length", 2.0, 3.0, length=length)), 2.0, 5.0)
    good = of(HEALTHY, READING)[40:100]
    assert [frame.data for frame in of(within, READING)] == [(f.data + bytes(8))[:length] for f in good]
    faults = {reading.fault for reading in readings(within)}
    assert faults == {ReadingFault.MALFORMED}


def test_a_damaged_frame_has_one_wrong_bit() -> None:
    frames = played(fault("corrupted", 2.0, 3.0))
    within = check_outside(frames, 2.0, 5.0)
    pairs = zip(of(within, READING), of(HEALTHY, READING)[40:100], strict=True)
    masks = [int.from_bytes(bad.data, "big") ^ int.from_bytes(good.data, "big") for bad, good in pairs]
    assert {mask.bit_count() for mask in masks} == {1}
    assert len(set(masks)) > 10
    some = of(played(fault("corrupted", 0.0, 10.0, share=0.3)), READING)
    damaged = sum(bad.data != good.data for bad, good in zip(some, of(HEALTHY, READING), strict=True))
    assert 34 <= damaged <= 86  # 60 of 200, four standard deviations


def test_a_frozen_frame_repeats_its_bytes_counter_and_all() -> None:
    within = check_outside(played(fault("frozen_frame", 2.0, 3.0)), 2.0, 5.0)
    frozen = of(within, READING)
    assert {frame.data for frame in frozen} == {of(HEALTHY, READING)[40].data}
    assert [frame.t_ns for frame in frozen] == [frame.t_ns for frame in of(HEALTHY, READING)[40:100]]


@pytest.mark.parametrize(
    ("error", "class_bits", "byte", "value"),
    [
        ("warning", 0x004, 1, 0x04),
        ("passive", 0x004, 1, 0x10),
        ("overflow", 0x004, 1, 0x01),
        ("bit_stuffing", 0x088, 2, 0x04),
        ("no_acknowledge", 0x020, 0, 0),
        ("lost_arbitration", 0x002, 0, 0),
    ],
)
def test_error_frames_look_as_the_kernel_makes_them(error: str, class_bits: int, byte: int, value: int) -> None:
    frames = played(fault("error_frames", 2.0, 1.0, error=error, rate_hz=20.0))
    errors = [frame for frame in frames if frame.is_error]
    assert [frame for frame in frames if not frame.is_error] == HEALTHY
    reports = [(f.t_ns - START_NS, f.arbitration_id, f.data[byte]) for f in errors if f.t_ns < START_NS + 3e9]
    assert reports == [(2_000_000_000 + i * 50_000_000, class_bits, value) for i in range(20)]
    assert all(len(frame.data) == 8 for frame in errors)
    ends = [(f.t_ns - START_NS, f.arbitration_id, f.data[1]) for f in errors[20:]]
    assert ends == ([(3_000_000_000, 0x004, 0x40)] if error in ("warning", "passive") else [])


def test_bus_off_is_told_twice_and_is_silence_between() -> None:
    frames = played(fault("bus_off", 2.0, 3.0), fault("flood", 1.0, 3.0, rate_hz=100.0, arbitration_id=0x55))
    within, _ = split(frames, 2.0, 5.0)
    assert [(f.t_ns - START_NS, f.arbitration_id, f.is_error) for f in within] == [(2_000_000_000, 0x040, True)]
    after = [frame for frame in frames if frame.t_ns >= START_NS + 5_000_000_000]
    assert (after[0].t_ns - START_NS, after[0].arbitration_id, after[0].is_error) == (5_000_000_000, 0x100, True)
    rest = [frame for frame in frames if not frame.is_error and frame.arbitration_id != 0x55]
    assert rest == split(HEALTHY, 2.0, 5.0)[1]


def test_a_flood_of_a_foreign_identifier_leaves_the_other_frames_alone() -> None:
    frames = played(fault("flood", 2.0, 1.0, rate_hz=2000.0, arbitration_id=0x7FF))
    flood = of(frames, FrameId(0x7FF))
    assert [frame.t_ns - START_NS for frame in flood] == [2_000_000_000 + i * 500_000 for i in range(2000)]
    assert [frame for frame in frames if frame not in flood] == HEALTHY
    assert [frame.t_ns for frame in frames] == sorted(frame.t_ns for frame in frames)


def test_a_babbling_controller_repeats_its_last_displacement() -> None:
    frames = of(played(fault("flood", 2.01, 1.0, rate_hz=1000.0)), READING)
    assert len(frames) == 200 + 1000
    assert set(values_mm(frames)) == set(TRUE_MM)
    genuine = {(frame.t_ns, frame.data) for frame in of(HEALTHY, READING)}
    last = None
    for frame in frames:
        if (frame.t_ns, frame.data) in genuine:
            last = frame.data
        else:
            assert frame.data == last


def test_faults_act_one_after_the_other_in_the_order_of_the_script() -> None:
    jump, stuck = fault("jump", 2.0, 3.0, offset_mm=40.0), fault("stuck_value", 3.0, 1.0)
    late_jump = fault("jump", 3.5, 0.2, offset_mm=7.0)
    frames = values_mm(played(jump, stuck, late_jump))
    assert frames[60:70] == [TRUE_MM[60] + 40] * 10
    assert frames[70:74] == [TRUE_MM[60] + 47] * 4
    assert frames[80] == TRUE_MM[80] + 40
    silent = played(fault("wrong_identifier", 2.0, 1.0), fault("can_silence", 2.0, 1.0))
    assert of(split(silent, 2.0, 3.0)[0], FrameId(0x3FF)) == []


@pytest.mark.parametrize("step_ns", [1_000_000, 333_000_000])
def test_frames_do_not_depend_on_when_they_are_asked_for(step_ns: int) -> None:
    faults = script(
        fault("corrupted", 1.0, 5.0, share=0.5),
        fault("noise_burst", 2.0, 3.0),
        fault("flood", 2.0, 0.2),
        fault("bus_off", 4.0, 0.5),
    )
    stepwise = source(faults)
    frames: list[Frame] = []
    for t_ns in range(START_NS, START_NS + 11_000_000_000, step_ns):
        due = stepwise.due(t_ns)
        assert all(frame.t_ns <= t_ns for frame in due)
        frames += due
    assert stepwise.next_t_ns is None
    assert frames == source(faults).due(1 << 62)


def test_a_canopen_sensor_that_knows_its_illness_sends_an_emergency() -> None:
    settings = DisplacementSettings(preset="cia406", node_id=5)
    faults = script(fault("sensor_error", 2.0, 3.0), fault("can_silence", 4.0, 2.0))
    controller = FaultyController(
        VirtualController(faulty_observations(OBSERVED, faults, START_NS), settings),
        faults,
        START_NS,
        reading_id=FrameId(0x185),
        bystander_id=LABORATORY,
    )
    frames = controller.due(1 << 62)
    emergencies = [frame for frame in frames if frame.arbitration_id == 0x085]
    # The one that would end it falls into the silence.
    assert [frame.t_ns - START_NS for frame in emergencies] == [2_000_000_000]
    assert split(frames, 4.0, 6.0)[0] == []


def test_the_interface_goes_down_and_away_at_its_times_and_is_left_as_found() -> None:
    shared = network("faulty-controller-test")
    faults = script(
        fault("interface_down", 1.01, 1.0),
        fault("interface_deleted", 3.01, 1.0),
        fault("interface_down", 3.51, 1.0),
    )
    controller = source(faults, shared.channel)
    changes = []
    frames: list[Frame] = []
    while (due_ns := controller.next_t_ns) is not None:
        due = controller.due(due_ns)
        frames += due
        if not due:
            changes.append(((due_ns - START_NS) / 1e9, shared.exists, shared.is_up))
    assert frames == HEALTHY
    assert changes == [
        (1.01, True, False),
        (2.01, True, True),
        (3.01, False, False),
        (3.51, False, False),
        (4.01, True, False),
        (4.51, True, True),
    ]
    interrupted = source(faults, shared.channel)
    interrupted.due(START_NS + 3_600_000_000)
    interrupted.close()
    assert (shared.exists, shared.is_up) == (True, True)


def test_a_reading_that_is_none_stays_none_under_other_faults() -> None:
    faults = script(fault("sensor_error", 0.0, 10.0), fault("jump", 0.0, 10.0, offset_mm=5.0))
    assert all(math.isnan(value) for _, value in faulty_observations(OBSERVED, faults, START_NS))
