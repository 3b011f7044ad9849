"""The papers' filters against matrices, and each method on a move whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.arrays import FloatArray
from estimation.methods.batch import Batch, Collector, Kind, Span, levelled_at_rest
from estimation.methods.clock import clock
from estimation.methods.corrected_c import corrected_c
from estimation.methods.integrate import integral, integrate_levelled, integrate_raw
from estimation.methods.outputs import outputs_of
from estimation.methods.paper_c import Reading, paper_c
from estimation.methods.registry import METHODS
from estimation.methods.two_state import Tuning, three_state, two_state
from estimation.records import Displacement, Estimate, ImuSample, Move, MoveKind, ReadingFault
from estimation.settings import MountSettings, SupportSettings

RATE_HZ = 819.2
G = 9.80665
ONSET_S, STOP_S, RAMP_S = 6.0, 16.0, 0.2
SPEED = 0.01453


def record(tilt: float = 0.0, bias: float = 0.0, noise: float = 0.0, seed: int = 1) -> tuple[Batch, FloatArray]:
    """A push with even acceleration at both ends, and its true displacement at each sample."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(round(24 * RATE_HZ)) / RATE_HZ
    v = SPEED * (np.clip((t_s - ONSET_S) / RAMP_S, 0, 1) - np.clip((t_s - STOP_S) / RAMP_S, 0, 1))
    accel = np.zeros((len(t_s), 3))
    accel[:, 1] = np.gradient(v, t_s) + G * np.sin(tilt) + bias
    accel[:, 2] = G * np.cos(tilt)
    accel += rng.normal(0.0, noise, accel.shape)
    seen_s = np.arange(0.05, 24.0, 0.07)
    p = np.asarray(integral(v, t_s))
    seen_m = np.interp(seen_s, t_s, p) + rng.normal(0.0, 0.003, len(seen_s))
    span = Span(ONSET_S, STOP_S, 1)
    return Batch(0, t_s, accel, np.zeros_like(accel), seen_s, seen_m, 0.0, SupportSettings(), moves=(span,)), p


def test_integral_is_exact_for_straight_lines() -> None:
    t_s = np.array([0.0, 0.1, 0.4, 1.0])
    np.testing.assert_allclose(integral(2.0 * t_s, t_s), t_s**2, atol=1e-12)


def test_integration_of_a_clean_record_is_the_truth_and_a_bias_runs_away() -> None:
    batch, true_m = record(tilt=0.03)
    np.testing.assert_allclose(integrate_levelled(batch).displacement_m, true_m, atol=2e-5)
    biased, _ = record(bias=0.002)
    # Half a b t^2 of what the raw method takes for level: the first second.
    assert integrate_raw(biased).displacement_m[-1] - true_m[-1] == pytest.approx(0.0, abs=1e-4)
    late, _ = record()
    late.accel[late.t_s >= 1.0, 1] += 0.002
    assert integrate_raw(late).displacement_m[-1] - true_m[-1] == pytest.approx(0.5 * 0.002 * 23.0**2, rel=0.01)


def test_level_is_taken_anew_in_each_rest() -> None:
    batch, _ = record()
    moves = (Span(6.0, 8.0, 1), Span(16.0, 18.0, -1))
    batch.accel[:, 1] = np.where(batch.t_s < 10.0, 0.3, -0.2)
    two = Batch(**{**batch.__dict__, "moves": moves})
    level = batch.accel[:, 1] - levelled_at_rest(two)
    assert set(np.round(level, 12)) == {0.3, -0.2}


def test_the_clock_goes_at_nominal_speed_from_onset_to_stop() -> None:
    batch, _ = record()
    course = clock(batch)
    assert course.displacement_m[-1] == pytest.approx(0.01453 * 10.0, abs=2e-5)
    assert course.displacement_m[round(11 * RATE_HZ)] == pytest.approx(0.01453 * 5.0, abs=2e-5)


def matrices(batch: Batch, a_mm: FloatArray, q: np.ndarray, r: float, bias_sigma: float) -> FloatArray:
    """Paper A, eq. (1)-(6), with numpy's matrices; a third state if q is 3 x 3."""
    n = len(q)
    x, p = np.zeros(n), np.zeros((n, n))
    x[0] = batch.start_m * 1e3
    if n == 3:
        p[2, 2] = bias_sigma**2
    h = np.zeros(n)
    h[0] = 1.0
    out, last_s, place = [], batch.t_s[0], 0
    for t_s, a in zip(batch.t_s, a_mm, strict=True):
        dt = t_s - last_s
        last_s = t_s
        b = np.array([dt * dt / 2, dt, 0.0])[:n]
        f = np.eye(n)
        f[0, 1] = dt
        if n == 3:
            f[:2, 2] = -b[:2]
        x = f @ x + b * a
        noise = q * np.outer(b, b) if n == 2 else np.diag([0.0, 0.0, q[2, 2] * dt]) + q[0, 0] * np.outer(b, b)
        p = f @ p @ f.T + noise
        while place < len(batch.seen_s) and batch.seen_s[place] <= t_s:
            gain = p @ h / (h @ p @ h + r)
            x = x + gain * (batch.seen_m[place] * 1e3 - h @ x)
            p = (np.eye(n) - np.outer(gain, h)) @ p
            place += 1
        out.append(x[:2])
    return np.array(out)


def test_two_and_three_states_are_the_matrix_filter() -> None:
    batch, _ = record(noise=0.05)
    a_mm = levelled_at_rest(batch) * 1e3
    two = two_state(batch, Tuning(900.0, 9.0, "BqB"))
    expected = matrices(batch, a_mm, np.full((2, 2), 900.0), 9.0, 0.0)
    np.testing.assert_allclose(np.column_stack([two.displacement_m, two.velocity_m_s]) * 1e3, expected, atol=1e-7)
    q = np.diag([900.0, 0.0, 4.0])
    three = three_state(batch, Tuning(900.0, 9.0, "BqB", 4.0, 20.0), a_mm / 1e3)
    expected = matrices(batch, a_mm, q, 9.0, 20.0)
    np.testing.assert_allclose(np.column_stack([three.displacement_m, three.velocity_m_s]) * 1e3, expected, atol=1e-6)


def test_only_the_ratio_of_q_to_r_matters() -> None:
    batch, _ = record(noise=0.05)
    for form in ("qI", "BqB"):
        one, other = (two_state(batch, Tuning(3.0 * k, 2.0 * k, form)) for k in (1.0, 1000.0))
        np.testing.assert_allclose(one.displacement_m, other.displacement_m, rtol=1e-9, atol=1e-12)


def vvm_matrices(y: FloatArray, dt: float, q: float, r: float) -> FloatArray:
    """Paper C, eq. (15), (16) and the recursion, from X = 0 and P = 0."""
    f = np.array([[1, dt, dt * dt / 2], [0, 1, dt], [0, 0, 1]])
    h = np.array([0.0, 0.0, 1.0])
    x, p, out = np.zeros(3), np.zeros((3, 3)), []
    for z in y:
        x, p = f @ x, f @ p @ f.T + np.diag([0.0, 0.0, q * q])
        gain = p @ h / (h @ p @ h + r * r)
        x, p = x + gain * (z - h @ x), (np.eye(3) - np.outer(gain, h)) @ p
        out.append(x)
    return np.array(out)


def test_vvm_is_the_matrix_filter_within_a_segment() -> None:
    batch, _ = record()  # without noise gravity turns nothing
    reading = Reading(segments=(Span(ONSET_S, STOP_S, 1),))
    course = paper_c(batch, reading)
    inside = (course.kind == Kind.VVS) & (batch.t_s < ONSET_S + 0.999)
    y = course_input(batch, reading)[inside]
    expected = vvm_matrices(y, 1 / RATE_HZ, reading.q_m_s2, reading.r_m_s2)
    got = np.column_stack([course.displacement_m, course.velocity_m_s, course.acceleration_m_s2])[inside]
    np.testing.assert_allclose(got, expected, atol=1e-6)  # the burst itself is felt as a little tilt


def course_input(batch: Batch, reading: Reading) -> FloatArray:
    """The filtered push acceleration; the sensor of this record does not turn."""
    from estimation.methods.wavelet import filtered

    return filtered(batch.accel, reading.level, reading.wavelet)[:, 1]


def test_held_speed_is_held_and_a_literal_reading_loses_the_push() -> None:
    batch, true_m = record()
    course = paper_c(batch, Reading(segments=(Span(ONSET_S, STOP_S, 1),)))
    # De-trending has taken the burst's speed away: next to nothing of 145 mm is left.
    assert abs(course.displacement_m[-1]) < 0.3 * true_m[-1]
    literal = paper_c(record(noise=0.05)[0])
    assert (literal.kind == Kind.VVS).mean() > 0.99  # everything is a change point
    assert len(literal.moves) == 2


@pytest.mark.parametrize("both", [False, True])
def test_the_corrected_reading_measures_a_clean_push(both: bool) -> None:
    batch, true_m = record(tilt=0.02)
    course = corrected_c(batch, both_bursts=both)
    assert course.displacement_m[-1] == pytest.approx(true_m[-1], abs=2e-4)
    even = course.kind == Kind.CVS
    np.testing.assert_allclose(course.velocity_m_s[even], SPEED, rtol=2e-3)
    assert course.velocity_m_s[-1] == course.velocity_m_s[0] == 0.0


def test_both_bursts_are_better_than_one() -> None:
    # White noise alone: the mean of two independent speeds has 0.7 of the error.
    errors: dict[bool, list[float]] = {False: [], True: []}
    for seed in range(40):
        batch, true_m = record(noise=0.05, seed=seed)
        for both, of in errors.items():
            of.append(corrected_c(batch, both_bursts=both).displacement_m[-1] - true_m[-1])
    ratio = np.std(errors[True]) / np.std(errors[False])
    assert ratio == pytest.approx(2**-0.5, abs=0.25)


def test_a_course_becomes_estimates_and_moves() -> None:
    batch, _ = record()
    told = list(outputs_of(batch, clock(batch)))
    steps, moves = [o for o in told if isinstance(o, Estimate)], [o for o in told if isinstance(o, Move)]
    assert len(steps) == len(batch.t_s) // 8
    assert np.isnan(steps[0].sigma_m)
    assert [(m.kind, m.onset_ns, m.stop_ns) for m in moves] == [(MoveKind.PUSH, 6 * 10**9, 16 * 10**9)]
    assert moves[0].end_m == pytest.approx(0.1453, abs=2e-5)
    assert moves[0].velocity_m_s == pytest.approx(0.01453)


def test_collected_records_are_turned_into_support_axes_and_bad_ones_left_out() -> None:
    collector = Collector(MountSettings(push="-x", up="+y"), start_m=0.1)
    for i in range(1100):
        collector.add(ImuSample(5 + i * 1_220_703, (0.1, 0.2, 0.3), (1.0, 9.8, 0.5)))
    collector.add(ImuSample(7, (0.0,) * 3, (9.0,) * 3))  # back in time
    collector.add(Displacement(1_000_000_005, 0.25))
    collector.add(Displacement(1_100_000_005, 0.3, ReadingFault.INVALID))
    batch = collector.batch()
    assert len(batch.t_s) == 1100
    np.testing.assert_allclose(batch.accel[0, 1:], [-1.0, 9.8])
    np.testing.assert_allclose(batch.gyro[0, 1:], [-0.1, 0.2])
    assert batch.seen_s.tolist() == [1.0]
    assert 1099 / (batch.t_s[-1] - batch.t_s[0]) == pytest.approx(819.2, rel=1e-4)
    with pytest.raises(ValueError, match="too few"):
        Collector().batch()


def test_every_method_says_what_it_is_and_streams_or_gives_a_course() -> None:
    batch, _ = record(noise=0.05)
    assert [name for name, method in METHODS.items() if method.course is None] == ["mskf"]
    for method in METHODS.values():
        assert method.about
        if method.course is not None:
            course = method.course(batch)
            assert len(course.displacement_m) == len(course.velocity_m_s) == len(course.kind) == len(batch.t_s)
            assert np.isfinite(course.displacement_m).all()
