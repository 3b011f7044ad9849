"""`ramstroke demo`: one virtual push and retract, measured, recorded, drawn and told."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import pytest

from daemon.cli import main
from daemon.offline.replaying.replay import replay
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import TOPICS
from daemon.simulation.demo import demo_settings
from daemon.simulation.fault_file import load_faults
from daemon.simulation.virtual import virtual_support
from drivers.adis16448.burst import Burst, Fault
from estimation.records import Move
from tests.conftest import DemoRun
from tests.daemon.recording_kit import SmallDisk, passes_official_reader

MOVE_KEYS = {
    "kind",
    "onset_s",
    "stop_s",
    "start_mm",
    "end_mm",
    "sigma_mm",
    "end_before_stop_mm",
    "sigma_before_stop_mm",
    "velocity_mm_s",
    "can_state",
    "tier",
}
WET_CABLE = Path(__file__).parents[2] / "config" / "faults" / "wet_cable.toml"
PNG = b"\x89PNG\r\n\x1a\n"


def test_the_report_says_what_was_measured_and_what_is_true(demo_run: DemoRun) -> None:
    report = demo_run.report
    assert demo_run.code == 0
    assert report.keys() == {"seed", "moves", "moves_expected", "recording", "picture"}
    assert (report["seed"], report["moves_expected"]) == (1, 2)
    assert [move["kind"] for move in report["moves"]] == ["push", "retract"]
    for move in report["moves"]:
        assert move.keys() == MOVE_KEYS | {"truth_mm", "error_mm", "error_before_stop_mm"}
        assert move["error_mm"] == pytest.approx(move["end_mm"] - move["truth_mm"])
        assert move["error_before_stop_mm"] == pytest.approx(move["end_before_stop_mm"] - move["truth_mm"])
        assert abs(move["error_mm"]) < 4 * move["sigma_mm"]
        assert 0 < move["sigma_mm"] <= move["sigma_before_stop_mm"] < 20
        assert move["onset_s"] < move["stop_s"]
        assert move["tier"] == "settled"
    push, retract = report["moves"]
    assert push["velocity_mm_s"] > 0 > retract["velocity_mm_s"]
    assert retract["start_mm"] == pytest.approx(push["end_mm"], abs=1)
    assert push["stop_s"] < retract["onset_s"]


def test_recording_and_picture_are_where_the_report_says(demo_run: DemoRun) -> None:
    recording, picture = Path(demo_run.report["recording"]), Path(demo_run.report["picture"])
    assert {recording, picture} == set(demo_run.folder.iterdir())
    assert (recording.name, picture.name) == ("demo.mcap", "demo.png")
    assert picture.read_bytes()[:8] == PNG
    assert passes_official_reader(recording) > 60_000


def test_the_recording_holds_everything_received_and_estimated(demo_run: DemoRun) -> None:
    recording = Recording(demo_run.recording)
    times: dict[str, list[int]] = {}
    for topic, record in recording.messages():
        times.setdefault(topic, []).append(TOPICS[topic].time_ns(record))
    assert (recording.complete, recording.lost, recording.damage) == (True, 0, [])
    assert recording.metadata["sensor"] == "virtual ADIS16448"
    counts = recording.counts
    assert counts[topics.IMU_IDENTITY] == 1
    assert topics.TICK not in counts
    assert counts[topics.PROVISIONAL] == counts[topics.SETTLED] == counts[topics.IMU_RAW] // 8
    assert counts[topics.CAN_RX] == counts[topics.OBSERVED] + counts[topics.REFERENCE]
    assert counts[topics.MOVES] == 2
    for topic in (topics.IMU_RAW, topics.CAN_RX, topics.PROVISIONAL, topics.SETTLED):
        assert times[topic] == sorted(times[topic]), topic


def test_the_same_seed_gives_the_same_moves_and_a_table_tells_them(
    demo_run: DemoRun, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--seed", "1", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    for word in ("estimate mm", "± 1σ mm", "truth mm", "error mm", "error before stop mm", "push", "retract"):
        assert word in printed.out.replace("\n", " "), word
    for move in demo_run.report["moves"]:
        for key in ("end_mm", "truth_mm", "sigma_mm"):
            assert f"{move[key]:.1f}" in printed.out
    assert printed.out.endswith(f"recording {tmp_path}/demo.mcap, picture {tmp_path}/demo.png\n")
    assert moves_in(tmp_path / "demo.mcap") == moves_in(demo_run.recording)


def moves_in(path: Path) -> list[Move]:
    moves = [record for _, record in Recording(path).messages((topics.MOVES,)) if isinstance(record, Move)]
    assert moves
    return moves


def test_another_seed_is_another_support() -> None:
    def truth(seed: int) -> list[float]:
        return [move.end_m for move in virtual_support(demo_settings(seed), cycles=1).true_moves()]

    assert truth(1) == truth(1) != truth(2)


def test_a_folder_that_cannot_be_made_is_told_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    for out, reason in (("file", "File exists"), ("file/below", "Not a directory")):
        assert main(["demo", "--out", str(tmp_path / out)]) == 1
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err == (f"ramstroke: cannot make the folder {tmp_path / out} ({reason}): choose another --out\n")


def test_a_recording_that_cannot_be_written_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    SmallDisk(room=100_000).hold_what_is_written(monkeypatch)
    assert main(["demo", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == (f"ramstroke: cannot write {tmp_path}/demo.mcap: No space left on device\n")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def faulty_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, dict[str, Any], Path]:
    folder = tmp_path_factory.mktemp("wet") / "out"
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        code = main(["demo", "--seed", "1", "--json", "--out", str(folder), "--faults", str(WET_CABLE)])
    return code, json.loads(printed.getvalue()), folder / "demo.mcap"


def test_with_faults_the_demo_runs_to_its_end_and_tells_them(
    faulty_run: tuple[int, dict[str, Any], Path], demo_run: DemoRun
) -> None:
    code, report, recording = faulty_run
    assert code == 0
    assert report.keys() == demo_run.report.keys() | {"faults", "events"}
    assert report["faults"] == [fault.model_dump() for fault in load_faults(WET_CABLE).fault]
    assert report["moves_expected"] == 2
    assert all(move["truth_mm"] == pytest.approx(move["end_mm"], abs=100) for move in report["moves"])
    said = " ".join(event["what"] for event in report["events"])
    assert "gap" in said
    times = [event["t_s"] for event in report["events"]]
    assert times == sorted(times)
    whole = Recording(recording)
    bursts = [record for _, record in whole.messages() if isinstance(record, Burst)]
    good = [burst.t_ns * 1e-9 for burst in bursts if burst.fault is Fault.NONE]
    # Dead wires give nothing good, and the motion is followed to its end all the same.
    for fault in load_faults(WET_CABLE).fault:
        if fault.kind in ("miso_low", "unplugged"):
            assert not [t_s for t_s in good if fault.at_s + 0.01 < t_s < fault.at_s + fault.for_s]
    healthy_end_s = max(
        r.t_ns for _, r in Recording(demo_run.recording).messages((topics.IMU_RAW,)) if isinstance(r, Burst)
    )
    assert max(good) == pytest.approx(healthy_end_s * 1e-9, abs=0.5)
    assert whole.counts[topics.IMU_IDENTITY] > 1
    assert whole.counts[topics.TICK] > 3


def test_with_faults_too_a_replay_of_the_recording_gives_the_same_bytes(
    faulty_run: tuple[int, dict[str, Any], Path],
) -> None:
    assert replay(faulty_run[2]).identical is True


def test_with_faults_the_table_is_followed_by_what_happened_in_order(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = tmp_path / "dead.toml"
    # Nothing to measure with: no move can be found, and that is no failure.
    script.write_text(
        '[[fault]]\nkind = "unplugged"\nat_s = 0.5\nfor_s = 1000\n'
        '[[fault]]\nkind = "can_silence"\nat_s = 0.2\nfor_s = 1000\n'
    )
    assert main(["demo", "--seed", "1", "--out", str(tmp_path), "--faults", str(script)]) == 0
    printed = capsys.readouterr()
    assert "0 of 2 moves were found" in printed.err
    lines = [line for line in printed.out.splitlines() if " s  script: " in line or " s  estimator: " in line]
    assert "0.20 s  script: can_silence for 1000 s: The controller is off" in lines[0]
    assert "0.50 s  script: unplugged for 1000 s: The connector is off" in lines[1]
    assert any("estimator: the inertial sensor is silent" in line for line in lines)
    times = [float(line.split(" s  ")[0]) for line in lines]
    assert times == sorted(times)


@pytest.mark.parametrize("seed", ["-1", "one", "1.5"])
def test_a_seed_that_is_none_is_wrong_usage(seed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", f"--seed={seed}", "--out", str(tmp_path / "out")]) == 2
    assert "--seed" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
