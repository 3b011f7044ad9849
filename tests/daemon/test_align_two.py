"""`ramstroke align` with a JY901 beside, beside the running daemon, into a configuration, and by other methods."""

from __future__ import annotations

import contextlib
import io
import json
import random
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.cli import main
from daemon.configuration import load
from daemon.offline.alignment.align import Alignment, align
from daemon.offline.alignment.grades import load_grades
from daemon.offline.alignment.rest import BLOCK_S, Rest
from daemon.offline.replaying.replay import replay
from daemon.recording.reader import Recording
from daemon.simulation.demo import demo_settings, run_demo
from daemon.simulation.virtual import virtual_support
from estimation.alignment.attitude import from_angles, misalignment, to_angles
from estimation.alignment.earth import Place
from estimation.alignment.verdict import Verdict
from estimation.mount.axes import Mount
from tests.acceptance.test_two_processes import started

LATITUDE_DEG = 39.84
G_M_S2 = Place(LATITUDE_DEG).gravity_m_s2


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One cycle with a JY901 beside the ADIS16448."""
    path = tmp_path_factory.mktemp("both") / "both.mcap"
    run_demo(demo_settings(1, "both"), path, lambda _: None)
    return path


@pytest.fixture(scope="module")
def rest(both: Path) -> Path:
    """Its first fifth, which holds the rest before the push: quicker to read."""
    path = both.with_name("rest.mcap")
    path.write_bytes(both.read_bytes()[: both.stat().st_size // 5])
    return path


def told(*arguments: object, code: int = 0) -> Any:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert main(["align", *map(str, arguments), "--latitude", str(LATITUDE_DEG), "--json"]) == code
    return json.loads(printed.getvalue()) if code == 0 else None


def tilt_felt(to_sensor: np.ndarray[Any, Any], bias: np.ndarray[Any, Any]) -> tuple[float, float]:
    """Pitch and roll that gravity and the accelerometers' bias make of a mount, without any filter."""
    x, y, z = to_sensor @ np.array([0.0, 0.0, G_M_S2]) + bias
    return float(np.degrees(np.arctan2(y, np.hypot(x, z)))), float(np.degrees(np.arctan2(-x, z)))


def test_both_sensors_are_aligned_and_compared(rest: Path) -> None:
    answer = told(rest, "--grade", "adis16448_turn_on", "--heading", 35)
    support = virtual_support(demo_settings(1, "both"), cycles=1)
    jy901 = support.jy901_input(np.eye(3))
    for told_of, to_sensor, errors in (
        (answer, support.to_sensor, support.sensor_errors),
        (answer["beside"], jy901._to_sensor, support.jy901_errors),
    ):
        for angle, true in zip(told_of["angles"], tilt_felt(to_sensor, errors.accel_bias), strict=False):
            # Scale, cross and drift errors of the parts remain: a few tenths of a percent of g.
            assert angle["value_deg"] == pytest.approx(true, abs=0.35)
            assert angle["verdict"] == "observed"
    assert answer["beside"]["grade"] == "jy901"
    pitch, roll, heading = answer["comparison"]
    for i, row in enumerate((pitch, roll)):
        main_deg, beside_deg = answer["angles"][i]["value_deg"], answer["beside"]["angles"][i]["value_deg"]
        assert row["difference_deg"] == pytest.approx(main_deg - beside_deg)
        assert row["sigma_deg"] == pytest.approx(np.hypot(1.14, 0.57), abs=0.03)
    assert heading["difference_deg"] is None  # one survey told both


def test_the_table_names_both_and_how_far_they_differ(rest: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["align", str(rest), "--latitude", "40"]) == 0
    out = capsys.readouterr().out
    assert "ADIS16448 as adis16448_in_run" in out
    assert "JY901 beside as jy901" in out
    assert "One less the other" in out


def test_a_jy901_instead_is_taken_as_one(tmp_path: Path) -> None:
    path = tmp_path / "jy901.mcap"
    run_demo(demo_settings(2, "jy901"), path, lambda _: None)
    answer = told(path)
    assert (answer["grade"], answer["beside"]) == ("jy901", None)
    assert answer["angles"][0]["sigma_deg"] == pytest.approx(0.57, abs=0.02)


def test_what_is_saved_levels_the_sensor_and_the_program_runs_with_it(both: Path, tmp_path: Path) -> None:
    config = tmp_path / "face.toml"
    config.write_text(
        "# ours\n[mount]\npush = '+y'  # along the ram\nup = '+z'\n[support]\nstroke_mm = 500\n"
        "[jy901]\nuse = 'beside'\n"
    )
    answer = told(both, "--grade", "adis16448_turn_on", "--heading", 35, "--save", config)
    text = config.read_text()
    assert "# along the ram" in text
    assert "aligned by ramstroke align" in text
    settings = load(config)
    assert settings.mount.pitch_deg == pytest.approx(answer["angles"][0]["value_deg"], rel=1e-5)
    assert settings.mount.heading_deg == 35
    assert settings.jy901_mount.roll_deg == pytest.approx(answer["beside"]["angles"][1]["value_deg"], rel=1e-5)
    support = virtual_support(demo_settings(1, "both"), cycles=1)
    x, y, z = support.to_sensor @ np.array([0.0, 0.0, G_M_S2]) + support.sensor_errors.accel_bias
    across, along, _ = Mount(settings.mount).to_support((x, y, z))
    assert np.hypot(across, along) < 0.005 * G_M_S2
    # The estimate holds with it, as without: the rest is levelled by the estimator anyway.
    own = demo_settings(1, "both")
    moves = replay(both, own.model_copy(update={"mount": settings.mount})).moves
    assert [move.end_m for move in moves] == pytest.approx([0.5, 0.0], abs=2e-3)
    # Once more, on the new configuration's recording or the old: the angles are those of the axes, not what is left.
    again = told(both, "--grade", "adis16448_turn_on", "--heading", 35, "--save", config)
    assert again["angles"] == answer["angles"]
    assert config.read_text().count("aligned by ramstroke align") == 2  # one in each section, the old ones replaced


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--save", "new.toml"], 1, "not saved: the pitch is doubtful"),
        (
            ["--grade", "adis16448_turn_on", "--beside-grade", "navigation", "--save", "n.toml"],
            1,
            "with --beside-grade",
        ),
        (["--method", "printed", "--grade", "adis16448_turn_on", "--save", "n.toml"], 1, "not saved: the pitch is as"),
        (["--method", "triadd"], 2, "did you mean triad?"),
        (["--method", "pso"], 2, "--method pso is one of --benchmark"),
        (["--beside-grade", "jy902"], 2, "did you mean jy901?"),
        (["--live"], 2, "name no recording beside it"),
        (["--config", "x.toml"], 2, "it goes with --live"),
        (["--plot", str(Path(__file__) / "pictures")], 2, "name a folder that can be written"),
    ],
)
def test_misuse_is_told_in_one_sentence(
    rest: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["align", str(rest), "--latitude", "40", *arguments]) == code
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not list(tmp_path.glob("*.toml"))


def test_with_a_picture_standard_output_is_one_object(rest: Path, tmp_path: Path) -> None:
    answer = told(rest, "--plot", tmp_path)
    assert Path(answer["picture"]).read_bytes()[:4] == b"\x89PNG"


def test_grades_of_ones_own_come_beside_those_of_the_program(rest: Path, tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text(
        "[mine]\ngyro_bias_deg_h = 20\nangle_walk_deg_sqrt_h = 0.6\naccel_bias_mg = 30\n"
        "velocity_walk_m_s_sqrt_h = 0.1\n"
    )
    answer = told(rest, "--grades", own, "--grade", "mine")
    assert (answer["grade"], answer["beside"]["grade"]) == ("mine", "jy901")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "[jy901]\nuse = 'beside'\n[mount]\npush = '+x'\n",
            'it has mount.push = "+x", the recording was made with "+y"',
        ),
        ("[jy901]\nuse = 'instead'\n", 'it has jy901.use = "instead", the recording was made with "beside"'),
        ("[jy901]\nuse = 'beside'\n[jy901_mount]\nup = '-z'\n", 'it has jy901_mount.up = "-z"'),
    ],
)
def test_a_tilt_is_not_saved_for_another_mount(
    rest: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: str
) -> None:
    config = tmp_path / "c.toml"
    config.write_text(text)
    arguments = ["--latitude", "40", "--grade", "adis16448_turn_on", "--save", str(config)]
    assert main(["align", str(rest), *arguments]) == 2
    captured = capsys.readouterr()
    assert words in captured.err
    assert "observed" in captured.out  # what was found is shown all the same
    assert config.read_text() == text


def test_saving_keeps_the_mode_of_the_file(rest: Path, tmp_path: Path) -> None:
    config = tmp_path / "c.toml"
    config.write_text("[jy901]\nuse = 'beside'\n")
    config.chmod(0o640)
    told(rest, "--grade", "adis16448_turn_on", "--save", config)
    assert config.stat().st_mode & 0o777 == 0o640
    assert "± 0.571 deg" in config.read_text().split("[jy901_mount]")[1]


def test_a_dead_band_is_told(both: Path) -> None:
    rest, _ = resting(1, "jy901", 10.0)
    numb = Rest(rest.force, np.zeros_like(rest.rate), rest.quiet)
    found = align(numb, load_grades()["jy901"], Place(LATITUDE_DEG))
    assert any("exactly zero in 100% of the rest" in fault for fault in found.faults)


def test_live_without_a_daemon_is_told(short_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = short_path / "c.toml"
    config.write_text(f'[service]\nsocket = "{short_path}/live"\n')
    assert main(["align", "--live", "--latitude", "40", "--config", str(config)]) == 1
    assert "no daemon answers on" in capsys.readouterr().err


def test_live_beside_the_running_daemon(short_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = short_path / "c.toml"
    config.write_text(
        '[imu]\ntransport = "virtual"\n[jy901]\nuse = "beside"\ntransport = "virtual"\n'
        f'[can]\ninterface = "virtual"\nchannel = "live-align-{random.random()}"\n'
        f'[recording]\ndirectory = "{short_path}/recordings"\nkeep_free_mb = 0\n'
        f'[service]\nsocket = "{short_path}/live"\nstate_file = "{short_path}/state.json"\n'
    )
    arguments = ["align", "--live", "--config", str(config), "--latitude", "40", "--duration", "6", "--json"]
    end_s = time.monotonic() + 100.0  # a push of 33 s may be under way
    with started("run", config) as daemon:
        while main([*arguments, "--grade", "adis16448_turn_on"]) != 0:
            assert daemon.poll() is None
            assert time.monotonic() < end_s, capsys.readouterr().err
            time.sleep(1.0)
    answer = json.loads(capsys.readouterr().out)
    assert answer["rest_s"] == pytest.approx(6.5, abs=1.5)
    assert answer["angles"][0]["verdict"] == "observed"
    assert answer["beside"] is not None
    assert Recording(Path(answer["file"])).metadata["kind"] == "recording"


def resting(seed: int, grade_name: str, seconds: float) -> tuple[Rest, np.ndarray[Any, Any]]:
    """A sensor of that grade, with biases of its own, whose attitude is known."""
    grade, place, rng = load_grades()[grade_name], Place(LATITUDE_DEG), np.random.default_rng(seed)
    pitch, roll = rng.uniform(-0.1, 0.1, 2)
    true = from_angles(pitch, roll, np.array(rng.uniform(-np.pi, np.pi)))
    count = round(seconds / BLOCK_S)
    walk = np.array([grade.angle_walk, grade.velocity_walk]) / BLOCK_S**0.5
    rate = true.T @ place.rate + grade.gyro_bias * rng.normal(size=3) + walk[0] * rng.normal(size=(count, 3))
    force = true.T @ np.array([0, 0, place.gravity_m_s2]) + grade.accel_bias * rng.normal(size=3)
    return Rest(force + walk[1] * rng.normal(size=(count, 3)), rate, np.ones(count, dtype=np.bool_)), true


@pytest.mark.parametrize("seconds", [20.0, 100.0])
def test_what_is_stated_of_a_heading_that_is_found_holds(seconds: float) -> None:
    """Eighty rests of sensors that feel the Earth, aligned from nothing: each error within its own sigma."""
    grade, place, runs = load_grades()["navigation"], Place(LATITUDE_DEG), 80
    squares = np.zeros(3)
    for seed in range(runs):
        rest, true = resting(seed, "navigation", seconds)
        found = align(rest, grade, place)
        angles = [angle.value for angle in found.angles]
        error = misalignment(from_angles(*(np.array(one) for one in angles)), true)
        squares += (error / [angle.sigma for angle in found.angles]) ** 2
        if seconds == 100.0:
            assert found.angles[2].verdict is Verdict.OBSERVED
    # chi-square of 80: 0.60 to 1.51 at 99.9 %; a stated sigma may be generous, not modest.
    assert (squares / runs < 1.51).all()
    assert (squares / runs > 0.3).all()


@pytest.mark.parametrize("method", ["triad", "printed"])
def test_coarse_methods_on_exact_vectors(method: str) -> None:
    place, true = Place(60.0), from_angles(np.array(0.05), np.array(-0.02), np.array(2.0))
    force = np.tile(true.T @ np.array([0, 0, place.gravity_m_s2]), (100, 1))
    rest = Rest(force, np.tile(true.T @ place.rate, (100, 1)), np.ones(100, dtype=np.bool_))
    found = align(rest, load_grades()["navigation"], place, method=method)
    assert [angle.value for angle in found.angles] == pytest.approx([float(one) for one in to_angles(true)], abs=1e-9)


def test_the_printed_coarse_alignment_spoils_the_level_of_a_poor_sensor() -> None:
    def off(found: Alignment, true: np.ndarray[Any, Any]) -> float:
        pitch, roll, _ = (float(one) for one in to_angles(true))
        return float(np.degrees(np.hypot(found.angles[0].value - pitch, found.angles[1].value - roll)))

    grade, place = load_grades()["adis16448_in_run"], Place(LATITUDE_DEG)
    errors: dict[str, list[float]] = {"ours": [], "triad": [], "printed": []}
    for seed in range(20):
        rest, true = resting(seed, "adis16448_in_run", 20.0)
        for method, told_of in errors.items():
            told_of.append(off(align(rest, grade, place, method=method), true))
    assert np.median(errors["ours"]) < 0.05
    assert np.median(errors["triad"]) < 0.05
    assert np.median(errors["printed"]) > 3.0
