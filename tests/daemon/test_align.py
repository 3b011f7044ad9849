"""`ramstroke align`: a table of a resting sensor whose attitude is known, the real recording, and bad input."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from daemon.cli import main
from daemon.offline.alignment.grades import load_grades
from estimation.alignment.attitude import from_angles
from estimation.alignment.earth import Place
from tests import broad

HEADER = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
PITCH_DEG, ROLL_DEG, HEADING_DEG, LATITUDE_DEG = 2.0, -1.5, 35.0, 40.0
RATE_HZ = 200.0
DEMO = Path(__file__).parents[1] / "data" / "regression" / "partial_push_and_retract.mcap"


def resting(
    folder: Path,
    rest_s: float,
    grade_name: str = "adis16448_in_run",
    *,
    turn_on_deg_s: float = 0.0,
    shock: bool = False,
    lifted_s: float = 1.0,
) -> Path:
    """A sensor of that grade at rest, then lifted."""
    grade, place = load_grades()[grade_name], Place(LATITUDE_DEG)
    rng = np.random.default_rng(11)
    n = round((rest_s + lifted_s) * RATE_HZ)
    t_s = np.arange(n) / RATE_HZ
    back = from_angles(*np.radians([PITCH_DEG, ROLL_DEG, HEADING_DEG])).T
    rate = back @ place.rate + np.radians([turn_on_deg_s, 0.0, -turn_on_deg_s])
    gyro = rate + grade.angle_walk * RATE_HZ**0.5 * rng.normal(size=(n, 3))
    force = back @ np.array([0, 0, place.gravity_m_s2]) + grade.velocity_walk * RATE_HZ**0.5 * rng.normal(size=(n, 3))
    force[t_s >= rest_s] += np.array([0.5, 1.0, 2.0])
    if shock:
        force[(t_s > 3.0) & (t_s < 3.05)] += 3.0
    table = folder / "rest.csv"
    rows = [
        f"{t:.6f}," + ",".join(f"{v:.9f}" for v in (*g, *f)) for t, g, f in zip(t_s.tolist(), gyro, force, strict=True)
    ]
    table.write_text("\n".join((HEADER, *rows)) + "\n")
    recording = folder / "rest.mcap"
    assert main(["import", str(table), "-o", str(recording)]) == 0
    return recording


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> Any:
    capsys.readouterr()
    assert main(["align", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_level_is_found_and_the_heading_is_the_surveys(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    recording = resting(tmp_path, 20.0, turn_on_deg_s=0.3, shock=True)
    answer = told(capsys, recording, "--latitude", LATITUDE_DEG, "--heading", HEADING_DEG)
    pitch, roll, heading = answer["angles"]
    assert answer["rest_s"] == pytest.approx(20.0, abs=0.11)
    assert 1 <= answer["shocks"] <= 2
    for angle, true in ((pitch, PITCH_DEG), (roll, ROLL_DEG)):
        assert angle["verdict"] == "observed"
        assert abs(angle["value_deg"] - true) < 3 * angle["sigma_deg"]
        assert angle["sigma_deg"] < 0.03
    assert heading["verdict"].startswith("not observed")
    assert heading["value_deg"] == pytest.approx(HEADING_DEG, abs=0.1)
    assert heading["sigma_deg"] == pytest.approx(1.0, abs=0.05)
    assert answer["gyro_bias_removed"]
    np.testing.assert_allclose(answer["gyro_bias_deg_s"], [0.3, 0.0, -0.3], atol=0.01)
    assert "turn-on bias" in answer["faults"][0]


def test_without_a_survey_this_sensor_has_no_heading(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    recording = resting(tmp_path, 10.0)
    heading = told(capsys, recording, "--latitude", LATITUDE_DEG)["angles"][2]
    assert heading["value_deg"] is None
    assert heading["verdict"].startswith("refused")
    assert main(["align", str(recording), "--latitude", "40"]) == 0
    assert "must come from the face survey" in capsys.readouterr().out


def test_a_navigation_grade_sensor_finds_north(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    recording = resting(tmp_path, 40.0, "navigation")
    heading = told(capsys, recording, "--latitude", LATITUDE_DEG, "--grade", "navigation")["angles"][2]
    assert abs(heading["value_deg"] - HEADING_DEG) < 3 * heading["sigma_deg"]
    assert heading["sigma_deg"] < 0.5


def test_level_of_the_real_recording_is_the_cameras(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Another sensor, whose accelerometers have no calibration here: a tenth of a degree is 1.7 mg."""
    real = broad.load()
    real.write_table(tmp_path / "broad.csv")
    assert main(["import", str(tmp_path / "broad.csv"), "-o", str(tmp_path / "broad.mcap")]) == 0
    answer = told(capsys, tmp_path / "broad.mcap", "--latitude", 52.5)
    seconds = np.array([float(t) for t in real.t_s])
    begun = int(np.flatnonzero(real.moving)[0])
    assert answer["rest_s"] == pytest.approx(seconds[begun] - seconds[0], abs=0.3)
    seen = real.orientation[:begun]
    w, x, y, z = seen[~np.isnan(seen).any(axis=1)].T
    turned = Rotation.from_quat(np.column_stack([x, y, z, w]))
    true = turned.mean().as_matrix()
    # The bias is what the gyroscopes say beyond the turning that the cameras saw.
    half, known_s = len(turned) // 2, seconds[:begun][~np.isnan(seen).any(axis=1)]
    seen_deg_s = (turned[:half].mean().inv() * turned[half:].mean()).as_rotvec(degrees=True) / (
        known_s[half:].mean() - known_s[:half].mean()
    )
    felt_deg_s = np.degrees(real.motion[:begun, :3].mean(axis=0))
    np.testing.assert_allclose(answer["gyro_bias_deg_s"], felt_deg_s - seen_deg_s, atol=0.03)
    pitch, roll, _ = answer["angles"]
    assert pitch["value_deg"] == pytest.approx(float(np.degrees(np.arcsin(true[2, 1]))), abs=0.1)
    assert roll["value_deg"] == pytest.approx(float(np.degrees(np.arctan2(-true[2, 0], true[2, 2]))), abs=0.1)


def test_benchmark_prints_what_is_possible_beside_the_paper(capsys: pytest.CaptureFixture[str]) -> None:
    answer = told(capsys, "--benchmark", "--runs", 20, "--method", "ours")
    assert len(answer["rows"]) == 27
    assert answer["printed"]["IFOA-KF"][2] == 2.42e-7
    yaw = {row["scenario"]: row["verdict"] for row in answer["rows"] if row["axis"] == "up"}
    assert yaw["AL-1"].startswith("not observed")
    assert yaw["AL-2"] == "observed"
    assert yaw["AL-5"].startswith("refused")


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--latitude", "40"], 2, "name the recording"),
        ([DEMO], 2, "--latitude is needed"),
        ([DEMO, "--latitude", "91"], 2, "latitude 91 deg"),
        ([DEMO, "--latitude", "40", "--height", "1e9"], 2, "height"),
        ([DEMO, "--latitude", "40", "--grade", "navigatoin"], 2, "did you mean navigation?"),
        ([DEMO, "--latitude", "40", "--heading", "nan"], 2, "--heading must be a finite number"),
        ([DEMO, "--latitude", "40", "--duration", "2"], 1, "of rest at its beginning are too little"),
        ([DEMO, "--benchmark"], 2, "a recording does not go with it"),
        (["--benchmark", "--runs", "1"], 2, "--runs must be at least 2"),
        ([Path("missing.mcap"), "--latitude", "40"], 1, "missing.mcap"),
        ([DEMO, "--latitude", "40", "--grades", Path("missing.toml")], 2, "missing.toml"),
    ],
)
def test_misuse_is_told_in_one_sentence(
    capsys: pytest.CaptureFixture[str], arguments: list[object], code: int, words: str
) -> None:
    assert main(["align", *map(str, arguments)]) == code
    said = capsys.readouterr().err
    assert words in said
    assert "Traceback" not in said


def test_a_sensor_that_is_moved_at_once_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    recording = resting(tmp_path, 2.0, lifted_s=6.0)
    assert main(["align", str(recording), "--latitude", "40"]) == 1
    assert "of rest" in capsys.readouterr().err


def test_own_grades_are_read_and_faults_in_them_named(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text("[mine]\ngyro_bias_deg_h = -1\naccel_bias_mg = 1\n")
    assert main(["align", "--grades", str(own), "--grade", "list"]) == 2
    said = capsys.readouterr().err
    assert "[mine] gyro_bias_deg_h" in said
    assert "[mine] angle_walk_deg_sqrt_h" in said
    assert main(["align", "--grade", "list"]) == 0
    assert "tactical" in capsys.readouterr().out
