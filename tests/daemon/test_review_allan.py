"""`ramstroke review --allan`: a virtual sensor of known noise, the real recording, and what cannot be judged."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal

from daemon.cli import main
from daemon.offline.alignment.allan import MARGIN_S, Allan, _longest_rest, allan
from daemon.offline.alignment.allan_plot import plot_allan
from daemon.offline.alignment.allan_report import grade_lines, remarks, row
from daemon.offline.alignment.grades import load_grades
from daemon.offline.plots import PlotError
from daemon.recording.metadata import describe
from daemon.recording.topics import IMU_SAMPLE
from daemon.recording.writer import RecordingWriter
from daemon.settings import Settings
from daemon.simulation.run import Devices, SimulatedRun
from daemon.simulation.stream import SimulatedStream
from drivers.clock import VirtualClock
from drivers.virtual.adis16448 import VirtualAdis16448
from drivers.virtual.controller import VirtualController
from drivers.virtual.inertial_input import InertialInput, RecordedInput
from drivers.virtual.motion import PlannedMove
from drivers.virtual.sensor_errors import SensorErrors, SensorGrade
from drivers.virtual.support import VirtualSupport
from estimation.arrays import FloatArray
from estimation.records import ImuSample, TimeKind
from tests import broad

RATE_HZ, PART_HZ = 100.0, 835.6
REST_S = 66.0
# A density of one side of the spectrum up to half the sample rate; N counts both sides.
TRUE_WALK_DEG = degrees(SensorGrade().gyro_noise_density / 2**0.5) * 60
TRUE_WALK_M_S = SensorGrade().accel_noise_density / 2**0.5 * 60
DEMO = Path(__file__).parents[1] / "data" / "regression" / "partial_push_and_retract.mcap"


def played(path: Path, source: InertialInput, errors: SensorErrors) -> Path:
    """A recording by the program's own driver of the virtual part."""
    settings = Settings.model_validate({"imu": {"transport": "virtual"}, "can": {"enabled": False}})
    clock = VirtualClock()
    controller = VirtualController(iter(()), settings.can.displacement, ())
    run = SimulatedRun(settings, Devices(controller, VirtualAdis16448(source, clock, errors=errors)), clock)
    metadata = describe("recording", settings.model_dump_json())
    written: list[RecordingWriter] = []
    with (
        SimulatedStream(settings, run, clock, lambda topic, record: written[0].write(topic, record)) as simulated,
        RecordingWriter(path, metadata, simulated.stream.attachments()) as writer,
    ):
        written.append(writer)
        simulated.play(lambda _: None)
    return path


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The virtual ADIS16448 on a floor where nothing moves."""
    t_ns = np.rint(np.arange(round(REST_S * PART_HZ)) / PART_HZ * 1e9)
    source = RecordedInput(t_ns, np.zeros((len(t_ns), 3)), np.tile([0.0, 0.0, 9.80665], (len(t_ns), 1)))
    path = tmp_path_factory.mktemp("quiet") / "quiet rest.mcap"
    return played(path, source, SensorErrors(np.random.default_rng(5)))


@pytest.fixture(scope="module")
def noise(quiet: Path) -> Allan:
    return allan(quiet)


def samples_written(path: Path, t_s: FloatArray, values: FloatArray) -> Path:
    """A recording of samples (n, 6): gyro, accel."""
    with RecordingWriter(path, describe("import", Settings().model_dump_json()), {}) as writer:
        for t, (a, b, c, x, y, z) in zip(t_s.tolist(), values.tolist(), strict=True):
            writer.write(IMU_SAMPLE, ImuSample(round(t * 1e9), (a, b, c), (x, y, z), 25.0, TimeKind.IMPORTED))
    return path


def resting(seconds: float, seed: int = 1) -> tuple[FloatArray, FloatArray]:
    """Times and samples (n, 6) of a level sensor with noise of 1e-4 rad/sqrt(s) and 1e-3 m/s/sqrt(s)."""
    n = round(seconds * RATE_HZ)
    sigma = np.repeat([1e-4, 1e-3], 3) * RATE_HZ**0.5
    values = np.random.default_rng(seed).normal(0.0, 1.0, (n, 6)) * sigma
    values[:, 5] += 9.81
    return np.arange(n) / RATE_HZ, values


def told(capsys: pytest.CaptureFixture[str], path: Path, *options: str) -> Any:
    capsys.readouterr()
    assert main(["review", str(path), "--allan", "--json", *options]) == 0
    return json.loads(capsys.readouterr().out)["allan"]


def said(capsys: pytest.CaptureFixture[str], path: Path, *options: str) -> str:
    capsys.readouterr()
    assert main(["review", str(path), "--allan", *options]) == 0
    return capsys.readouterr().out


def test_true_noise_densities_of_the_virtual_sensor_are_found(noise: Allan) -> None:
    answer = row(noise)
    assert answer["rest_s"] == pytest.approx(REST_S, abs=0.5)
    assert answer["rate_hz"] == pytest.approx(PART_HZ, rel=1e-3)
    assert answer["missing"] == 0
    names = [f"{kind} {axis}" for kind in ("gyro", "accel") for axis in "xyz"]
    assert [axis["axis"] for axis in answer["axes"]] == names
    for axis in answer["axes"]:
        gyro = axis["axis"].startswith("gyro")
        walk, true = ("deg_sqrt_h", TRUE_WALK_DEG) if gyro else ("m_s_sqrt_h", TRUE_WALK_M_S)
        found, sigma = axis[f"white_{walk}"], axis[f"white_sigma_{walk}"]
        assert found == pytest.approx(true, abs=4 * sigma)
        # The filter's seven taps take noise away at short times: the line begins behind them.
        assert 7 < axis["white_from_s"] * PART_HZ < 40
        assert sigma < 0.04 * true
        deviation = np.array(axis["deviation_deg_h" if gyro else "deviation_mg"])
        assert len(deviation) == len(answer["tau_s"]) == len(answer["clusters"])
        at_one_second = found * 60 if gyro else found / 60 / 9.80665e-3
        assert np.interp(1.0, answer["tau_s"], deviation) == pytest.approx(at_one_second, rel=0.2)
    grade = answer["grade"]
    assert answer["obstacles"] == []
    worst_walk = max(axis["white_deg_sqrt_h"] for axis in answer["axes"][:3])
    assert grade["angle_walk_deg_sqrt_h"] == pytest.approx(worst_walk)
    assert grade["accel_bias_mg"] == pytest.approx(max(axis["instability_mg"] for axis in answer["axes"][3:]))


def test_the_printed_grade_is_one_that_align_takes(
    quiet: Path, noise: Allan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture, own = tmp_path / "allan.png", tmp_path / "own.toml"
    lines = said(capsys, quiet, "--plot", str(picture)).splitlines()
    assert f"Picture: {picture}" in lines
    assert picture.read_bytes().startswith(b"\x89PNG")
    begin = lines.index("[quiet_rest]")
    assert "Turn-on biases are not in it" in lines[begin - 1]
    own.write_text("\n".join(lines[begin - 2 :]) + "\n")
    printed, grade = load_grades(own)["quiet_rest"].model_dump(), noise.grade()
    assert grade is not None
    assert printed.pop("source") == "Allan deviation of quiet rest.mcap, 66 s of rest"
    assert printed == pytest.approx(grade.model_dump(exclude={"source"}), rel=1e-3)
    assert any(line.startswith("At most: the floor was not reached in 66 s") for line in lines)
    align = ["align", str(quiet), "--latitude", "40", "--grades", str(own), "--grade", "quiet_rest", "--json"]
    assert main(align) == 0
    assert json.loads(capsys.readouterr().out)["grade"] == "quiet_rest"


def test_a_shaking_rest_before_a_push_is_told_to_shake(tmp_path: Path) -> None:
    """The white noise of the sensor is read behind the vibration, which stays in curve and words."""
    support = VirtualSupport(5, cycles=1, script=(PlannedMove(REST_S, 0.05, 0.01453),), clock_error=0.02)
    found = allan(played(tmp_path / "shaking.mcap", support.inertial_input(), support.sensor_errors))
    assert found.rest_s == pytest.approx(REST_S - MARGIN_S, abs=1.0)
    assert any(remark.startswith("Something shakes (") for remark in remarks(found))
    assert max(axis.excess for axis in found.accel) > 1.5
    for axis in found.accel:
        if axis.noise.white is not None:
            true = TRUE_WALK_M_S / 60
            assert axis.noise.white.density == pytest.approx(true, abs=4 * axis.noise.white.sigma)


def test_the_real_recordings_noise_is_that_of_its_spectrum(tmp_path: Path) -> None:
    real = broad.load()
    real.write_table(tmp_path / "broad.csv")
    assert main(["import", str(tmp_path / "broad.csv"), "-o", str(tmp_path / "broad.mcap")]) == 0
    found = allan(tmp_path / "broad.mcap", least_s=5.0)
    begun = float(real.t_s[int(np.flatnonzero(real.moving)[0])])
    assert found.start_s == pytest.approx(float(real.t_s[0]))
    assert found.rest_s == pytest.approx(begun - MARGIN_S - float(real.t_s[0]), abs=0.5)
    assert 1 / found.period_s == pytest.approx(2000 / 7, rel=1e-4)
    for axis, values in zip((*found.gyro, *found.accel), real.motion[: found.samples].T, strict=True):
        hz, power = signal.welch(values, 1 / found.period_s, nperseg=512)
        density = np.sqrt(power[(hz > 1) & (hz < 30)].mean() / 2)
        assert axis.noise.white is not None
        assert axis.noise.white.density == pytest.approx(density, rel=0.15)
        assert axis.noise.instability is not None
        assert not axis.noise.instability.reached


def test_the_longest_rest_is_taken_without_handling_and_gaps(tmp_path: Path) -> None:
    """Put down in the first 8 s, a hole at 75 s, turned on its side from 160 to 162 s; single samples lost."""
    t_s, values = resting(200.0)
    values[t_s < 8, 3:] += np.sin(t_s[t_s < 8])[:, None] * [2.0, 1.0, 0.0]
    turned = np.clip((t_s - 160) / 2, 0, 1) * np.pi / 2
    values[:, 3] += 9.81 * np.sin(turned)
    values[:, 5] += 9.81 * (np.cos(turned) - 1)
    kept = ~((t_s > 75) & (t_s < 75.5))
    kept[10_000:15_000:50] = False
    found = allan(samples_written(tmp_path / "moved.mcap", t_s[kept], values[kept]))
    assert 75.5 <= found.start_s < 75.7 + MARGIN_S  # the estimator doubts the first steps behind a gap
    assert found.start_s + found.rest_s == pytest.approx(160 - MARGIN_S, abs=1.1)
    assert found.missing == 100
    assert found.period_s == pytest.approx(0.01, rel=0.015)
    white = found.accel[0].noise.white
    assert white is not None
    assert white.density == pytest.approx(1e-3, abs=4 * white.sigma)


def test_another_sensor_ends_a_rest() -> None:
    t_ns = np.arange(1000) * 10_000_000
    nothing = np.array([], dtype=np.int64)
    still = np.zeros((1000, 6))
    assert _longest_rest(t_ns, still, nothing, nothing) == (0, 1000)
    assert _longest_rest(t_ns, still, nothing, t_ns[[299]]) == (300, 1000)
    assert _longest_rest(t_ns, still, t_ns[[650]], nothing) == (0, 450)
    assert _longest_rest(t_ns[:1], still[:1], nothing, nothing) == (0, 0)
    assert _longest_rest(t_ns[:300], still[:300], t_ns[[150]], nothing) == (0, 0)


def constant(path: Path, columns: Sequence[int]) -> Path:
    t_s, values = resting(70.0)
    values[:, columns] = 0.001
    return samples_written(path, t_s, values)


def test_constant_gyroscopes_are_not_without_noise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = constant(tmp_path / "dead.mcap", [0, 1, 2])
    words = said(capsys, path, "--plot", str(tmp_path / "dead.png"))
    assert "gyro y reads the same in every sample" in words
    assert "No grade: the gyroscopes show no noise" in words
    assert "[dead]" not in words
    answer = told(capsys, path)
    assert answer["grade"] is None
    assert [answer["axes"][0][key] for key in ("white_deg_sqrt_h", "instability_deg_h", "held")] == [None, None, 1.0]
    assert answer["axes"][3]["white_m_s_sqrt_h"] == pytest.approx(0.06, rel=0.1)


def test_one_constant_axis_is_left_out_of_the_grade(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    answer = told(capsys, constant(tmp_path / "half.mcap", [1]))
    worst_walk = max(answer["axes"][number]["white_deg_sqrt_h"] for number in (0, 2))
    assert answer["grade"]["angle_walk_deg_sqrt_h"] == pytest.approx(worst_walk)


def test_a_file_of_any_name_makes_a_table_that_can_be_read(tmp_path: Path) -> None:
    found = allan(constant(tmp_path / 'a "b"\t\\é.x.mcap', []))
    ((name, values),) = tomllib.loads("\n".join(grade_lines(found))).items()
    assert name == "a__b_____x"
    assert values["source"] == 'Allan deviation of a "b"_\\é.x.mcap, 70 s of rest'


def test_a_picture_that_cannot_be_written_is_named(noise: Allan, tmp_path: Path) -> None:
    for name in ("none/x.png", "x.nothing"):
        with pytest.raises(PlotError, match=name):
            plot_allan(tmp_path / name, noise)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ([DEMO, "--allan"], 1, "--allan wants 60 s at least"),
        ([DEMO, "--plot", "x.png"], 2, "name --allan beside it"),
        ([DEMO, "--allan", "--plot", DEMO], 1, "name another file for the result"),
        ([Path("missing.mcap"), "--allan"], 1, "missing.mcap"),
    ],
)
def test_misuse_is_told_in_one_sentence(
    capsys: pytest.CaptureFixture[str], arguments: list[object], code: int, words: str
) -> None:
    assert main(["review", *map(str, arguments)]) == code
    captured = capsys.readouterr()
    assert words in captured.err
    assert len(captured.err.splitlines()) == 1


def test_a_recording_without_samples_has_no_rest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = samples_written(tmp_path / "empty.mcap", np.empty(0), np.empty((0, 6)))
    assert main(["review", str(path), "--allan"]) == 1
    assert "lasts 0.0 s" in capsys.readouterr().err


def test_without_the_option_nothing_is_told_of_noise(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["review", str(DEMO), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["allan"] is None
