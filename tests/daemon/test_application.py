"""The daemon as one program, in this process and in real time, on the virtual part and the virtual bus."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from daemon.cli import main
from daemon.offline.replaying.replay import replay
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import Health, LogLine, Recorded, RecordedDisplacement
from daemon.service import application, state_file, watchdog
from daemon.service.application import Application
from daemon.service.live_client import first_line
from daemon.service.notify import Notifier
from daemon.settings import Settings
from drivers.adis16448.burst import Burst
from drivers.can.estimate_frame import decode_estimate
from drivers.can.frame import Frame
from drivers.can.interface import to_frame
from drivers.virtual.can_network import NetworkBus
from estimation.records import CanState, Event, Move, MoveKind, Segment, Tier, TimeKind
from tests.daemon.application_kit import PATIENCE_S, Viewer, forever, run, settings_in

WORKING = ("ok", "ill")

pytestmark = pytest.mark.usefixtures("unsettled_process")


def recorded(settings: Settings) -> tuple[Path, dict[str, list[Recorded]]]:
    """The one file of the run, with its messages by topic."""
    (path,) = settings.recording.directory.iterdir()
    messages: dict[str, list[Recorded]] = {}
    recording = Recording(path)
    for topic, record in recording.messages():
        messages.setdefault(topic, []).append(record)
    assert (recording.complete, recording.lost, recording.damage) == (True, 0, [])
    return path, messages


def frames_of(records: list[Recorded]) -> list[Frame]:
    return [record for record in records if isinstance(record, Frame)]


def test_a_viewer_that_comes_late_learns_the_last_moves_and_events_and_status_stays_short(
    short_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = settings_in(short_path)
    running = Application(settings)
    kept = application.MOVES_KEPT, application.EVENTS_KEPT
    for number in range(200):
        t_ns = number * 1_000_000_000
        running._receive(topics.EVENTS, Event(t_ns, f"event {number}"))
        end_m = float("nan") if number == 199 else number * 1e-3
        numbers = (0.0, end_m, 0.001, end_m, 0.002, 0.0146)
        running._receive(topics.MOVES, Move(number, MoveKind.PUSH, t_ns, t_ns, *numbers, CanState.OK, Tier.SETTLED))
    greetings: list[dict[str, Any]] = []

    async def scene() -> None:
        while not settings.service.socket.exists():
            await asyncio.sleep(0.01)
        greetings.append(await asyncio.to_thread(first_line, settings.service.socket))
        config = short_path / "c.toml"
        config.write_text(f'[service]\nsocket = "{settings.service.socket}"\n')
        assert await asyncio.to_thread(main, ["status", "--json", "--config", str(config)]) == 0

    run(running, scene)
    moves, events = greetings[0]["moves"], greetings[0]["events"]
    assert (len(moves), len(events)) == kept
    assert [row["what"] for row in events] == [f"event {number}" for number in range(100, 200)]
    assert [row["end_mm"] for row in moves] == [*(pytest.approx(number) for number in range(150, 199)), None]
    assert json.loads(capsys.readouterr().out).keys() == greetings[0].keys() - {"moves", "events"}


@pytest.fixture
def systemd(short_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.bind(str(short_path / "notify"))
        channel.setblocking(False)
        yield channel


def words(channel: socket.socket) -> list[str]:
    said = []
    with contextlib.suppress(BlockingIOError):
        while True:
            said.append(channel.recv(4096).decode())
    return said


def test_a_run_measures_records_publishes_and_tells(
    short_path: Path, systemd: socket.socket, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = settings_in(short_path)
    viewer = Viewer(settings)
    seen: list[Frame] = []
    greetings: list[dict[str, Any]] = []
    printed: list[str] = []

    async def scene() -> None:
        with NetworkBus(settings.can.channel) as third:
            await viewer.read_until(lambda line: line["type"] == "status" and line["estimate"] is not None)
            for _ in range(2):
                await viewer.read_until(lambda line: line["type"] == "status")
            greetings.append(await asyncio.to_thread(first_line, settings.service.socket))
            config = short_path / "c.toml"
            config.write_text(f'[service]\nsocket = "{settings.service.socket}"\n')
            assert await asyncio.to_thread(main, ["status", "--config", str(config)]) == 0
            printed.append(capsys.readouterr().out)
            while (message := third.recv(0)) is not None:
                if message.arbitration_id == settings.can.publish.arbitration_id:
                    seen.append(to_frame(message, 0))

    run(Application(settings, Notifier(str(short_path / "notify"))), scene)

    # viewers
    (greeting,) = greetings
    assert greeting["type"] == "hello"
    assert greeting.keys() >= {"version", "stroke_mm", "t_s", "imu", "can", "recorder", "live", "estimate", "learned"}
    assert greeting["learned"] is None
    assert greeting["moves"] == []
    told = [{"type": "event"} | event for event in greeting["events"]]
    assert told == viewer.of("event")[: len(told)]
    # A computer that is busy with other tests may miss samples.
    assert (greeting["imu"]["state"] in WORKING, greeting["can"]["state"]) == (True, "ok")
    assert greeting["imu"]["starts"] == 1
    assert greeting["imu"]["samples"] > 500
    assert greeting["can"]["received"] > 20
    assert greeting["can"]["sent"] > 10
    assert greeting["displacement"]["frames"] > 20
    assert greeting["displacement"]["state"] == greeting["recorder"]["state"] == "ok"
    assert greeting["loop"].keys() >= {"late_ms", "culprit", "culprit_ms"}
    for part in ("imu", "can", "displacement", "estimator", "recorder", "loop"):
        assert greeting[part].keys() >= {"state", "since_s", "what", "advice"}
        assert greeting[part]["since_s"] <= greeting["t_s"]
    assert greeting["recorder"]["messages"] > 500
    assert greeting["live"] == {"viewers": 1, "dropped": 0, "refused": 0}  # beside the asker
    assert abs(greeting["estimate"]["displacement_mm"]) < 4 * greeting["estimate"]["sigma_mm"] < 40
    assert (greeting["estimate"]["segment"], greeting["estimate"]["can_state"]) == ("ZUPT", "ok")
    assert len(viewer.of("status")) >= 3
    assert len(viewer.of("estimate")) > 5 * len(viewer.of("status"))
    row = viewer.of("estimate")[-1]
    assert row["chart_lower_m_s2"] < row["chart_upper_m_s2"]
    assert -0.1 < row["t_s"] - row["observed_s"] < 1  # a reading may be newer than the step
    assert abs(row["observed_mm"]) < 30
    for word in ("stroke", "mm (1σ)", "imu", "displacement", "recorder", "ok", "viewers", "nothing learned yet"):
        assert word in printed[0]

    # recording
    path, messages = recorded(settings)
    assert replay(path).identical is True
    healths = [json.loads(r.json) for r in messages[topics.HEALTH] if isinstance(r, Health)]
    assert len(healths) >= 3
    assert all(health["imu"]["state"] in WORKING for health in healths[1:])
    assert any(isinstance(r, LogLine) and r.text.endswith(" runs") for r in messages[topics.LOG])
    assert topics.TICK not in messages  # the part was never silent, not even while it started
    assert topics.EVENTS not in messages
    last_row = {round(row["observed_s"], 6): row["observed_mm"] for row in viewer.of("estimate")}
    readings = [r.reading for r in messages[topics.OBSERVED] if isinstance(r, RecordedDisplacement)]
    recorded_mm = {round(r.t_ns * 1e-9, 6): round(r.value_m * 1e3, 3) for r in readings}
    assert last_row.items() <= recorded_mm.items()  # what viewers see is what came

    # CAN
    sent = frames_of(messages[topics.CAN_TX])
    assert len(seen) > 10
    assert [frame.data for frame in sent[: len(seen)]] == [frame.data for frame in seen]
    estimates = [decode_estimate(frame) for frame in seen]
    assert [e.counter for e in estimates] == [i % 16 for i in range(len(seen))]
    assert all(e.segment is Segment.ZUPT for e in estimates)
    span_s = (sent[-1].t_ns - sent[0].t_ns) * 1e-9
    assert span_s == pytest.approx(0.1 * (len(sent) - 1), rel=0.2)
    assert all(frame.arbitration_id != 0x6F0 for frame in frames_of(messages[topics.CAN_RX]))

    # what remains
    assert not settings.service.socket.exists()
    start = state_file.load(settings.service.state_file, settings)
    assert start.displacement_m is not None
    assert abs(start.displacement_m) < 0.02
    assert start.only_without_sensor
    said = words(systemd)
    assert said[0] == "READY=1"
    assert said[-1] == "STOPPING=1"
    assert said.count("STOPPING=1") == said.count("READY=1") == 1
    assert said.count("WATCHDOG=1") >= 2
    assert any("mm, ZUPT" in word for word in said)


def test_a_move_that_taught_something_is_saved_at_once(short_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(application, "SAVE_STATE_S", 3600.0)
    settings = settings_in(short_path, can={"enabled": False})
    running, viewer = Application(settings), Viewer(settings)
    saved: list[state_file.SavedState] = []

    async def scene() -> None:
        await viewer.read_until(lambda line: line["type"] == "estimate")
        assert not settings.service.state_file.exists()
        running._stream.pipeline.state.settled.pushes_learned += 1
        while not settings.service.state_file.exists():
            await asyncio.sleep(0.05)
        saved.append(state_file.read(settings.service.state_file, settings))

    run(running, scene)
    assert saved[0].learned is not None
    assert saved[0].learned.pushes == 1


def test_the_watchdog_is_fed_while_a_missing_sensor_is_retried(
    short_path: Path, systemd: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A support that is switched off must not get its daemon killed for ever."""
    monkeypatch.setattr(application, "START_UP_S", 0.3)
    monkeypatch.setattr(application, "HEALTH_S", 0.4)
    settings = settings_in(short_path, imu={"transport": "socket", "socket_path": str(short_path / "nobody")})
    heard: list[str] = []

    async def scene() -> None:
        while "WATCHDOG=1" not in heard:
            heard.extend(words(systemd))
            await asyncio.sleep(0.02)

    run(Application(settings, Notifier(str(short_path / "notify"))), scene)


def test_the_watchdog_is_fed_while_devices_are_missing_but_not_once_a_part_hangs(
    short_path: Path, systemd: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sensor that is switched off is no reason to end the program; a thread that stands still is one."""
    monkeypatch.setattr(application, "START_UP_S", 0.3)
    monkeypatch.setattr(application, "HEALTH_S", 0.1)
    monkeypatch.setattr(watchdog, "PATIENCE_S", 1.6)  # the CAN task counts once a second
    settings = settings_in(short_path, imu={"transport": "socket", "socket_path": str(short_path / "nobody")})
    hanging = Application(settings, Notifier(str(short_path / "notify")))
    viewer = Viewer(settings)
    said: list[list[str]] = []

    async def statuses(count: int) -> None:
        for _ in range(count):
            await viewer.read_until(lambda line: line["type"] == "status")

    async def scene() -> None:
        with NetworkBus(settings.can.channel):
            await viewer.read_until(lambda line: line["type"] == "status" and line["estimate"] is not None)
            words(systemd)
            await statuses(5)
            said.append(words(systemd))
            monkeypatch.setattr(type(hanging._imu), "progress", 7)
            await statuses(22)
            words(systemd)
            await statuses(5)
            said.append(words(systemd))

    run(hanging, scene)
    fed, starved = said
    assert "WATCHDOG=1" in fed
    assert any("imu waiting: no virtual sensor answers" in word for word in fed)
    assert "WATCHDOG=1" not in starved
    assert any(word.startswith("STATUS=") and "imu has stood still for" in word for word in starved)
    path, messages = recorded(settings)
    assert len(messages[topics.TICK]) > 5
    assert replay(path).identical is True


def test_a_sensor_that_takes_its_time_to_start_does_not_cost_the_saved_stroke(
    short_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until the part has had time to start it is not silent, and no time passes blindly."""
    monkeypatch.setattr(application, "HEALTH_S", 0.2)
    settings = settings_in(
        short_path,
        imu={"transport": "socket", "socket_path": str(short_path / "nobody")},
        can={"enabled": False},
    )
    viewer = Viewer(settings)

    async def scene() -> None:
        for _ in range(5):
            await viewer.read_until(lambda line: line["type"] == "status")

    run(Application(settings), scene)
    _, messages = recorded(settings)
    assert messages.keys() == {topics.LOG, topics.HEALTH}
    assert not settings.service.state_file.exists()  # nothing to remember


def test_a_stop_during_the_start_ends_cleanly(short_path: Path, systemd: socket.socket) -> None:
    settings = settings_in(short_path)
    stopped = Application(settings, Notifier(str(short_path / "notify")))
    stopped.stop()
    asyncio.run(asyncio.wait_for(stopped.run(), PATIENCE_S))
    recorded(settings)
    assert not settings.service.socket.exists()
    assert words(systemd) == ["READY=1", "STOPPING=1"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_run_cleanly(number: signal.Signals, short_path: Path) -> None:
    settings = settings_in(short_path, can={"enabled": False})
    viewer = Viewer(settings)

    async def scene() -> None:
        await viewer.read_until(lambda line: line["type"] == "estimate")
        os.kill(os.getpid(), number)
        await forever()

    run(Application(settings), scene)
    path, _ = recorded(settings)
    assert replay(path).identical is True


async def fail() -> None:
    raise ZeroDivisionError("a fault of the program")


def test_a_fault_in_a_task_ends_the_run_with_it(short_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = settings_in(short_path)
    faulty = Application(settings)
    monkeypatch.setattr(faulty, "_watch_health", fail)
    with pytest.raises(ZeroDivisionError):
        run(faulty, forever)
    recorded(settings)
    assert not settings.service.socket.exists()


@pytest.mark.parametrize(("topic", "number"), [(topics.IMU_RAW, 60), (topics.CAN_RX, 150)])
def test_a_fault_in_the_estimator_ends_the_run_with_it_and_a_whole_recording(
    topic: str, number: int, short_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = settings_in(short_path)
    faulty = Application(settings)
    taken: list[str] = []
    take, stream = faulty._stream.take, faulty._stream

    def take_some(of: str, record: Recorded) -> None:
        take(of, record)
        taken.append(of)
        if of == topic and taken.count(topic) >= number:
            raise ZeroDivisionError

    monkeypatch.setattr(stream, "take", take_some)
    monkeypatch.setattr(stream, "finish", lambda: pytest.fail("a broken estimator was asked for more"))
    with pytest.raises(ZeroDivisionError):
        run(faulty, forever)
    path, messages = recorded(settings)
    assert taken.count(topic) == len(messages[topic]) == number
    monkeypatch.undo()
    assert replay(path).identical is True


def test_a_fault_at_the_very_end_is_told_and_leaves_a_whole_recording(
    short_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = settings_in(short_path)
    faulty, viewer = Application(settings), Viewer(settings)

    def fail_to_finish() -> None:
        raise ZeroDivisionError("a fault of the program")

    monkeypatch.setattr(faulty._stream, "finish", fail_to_finish)

    async def scene() -> None:
        await viewer.read_until(lambda line: line["type"] == "estimate")

    with pytest.raises(ZeroDivisionError):
        run(faulty, scene)
    recorded(settings)
    assert not settings.service.socket.exists()


def test_a_socket_in_use_is_told_in_one_sentence(short_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config, path = short_path / "c.toml", short_path / "live"
    config.write_text(
        '[imu]\ntransport = "virtual"\n[can]\nenabled = false\n'
        f'[recording]\ndirectory = "{short_path}/recordings"\n'
        f'[service]\nsocket = "{path}"\nstate_file = "{short_path}/state.json"\n'
    )
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
        other.bind(str(path))
        other.listen()
        assert main(["run", "--config", str(config)]) == 1
    assert capsys.readouterr().err.endswith(
        f"ramstroke: cannot serve viewers on {path} (another daemon already serves it): correct service.socket\n"
    )
    assert not (short_path / "recordings").exists()  # nothing half-started


def test_without_recorder_and_can_the_stroke_is_estimated_all_the_same(short_path: Path) -> None:
    settings = settings_in(short_path, recording={"enabled": False}, can={"enabled": False})
    viewer = Viewer(settings)
    statuses: list[dict[str, Any]] = []

    async def scene() -> None:
        await viewer.read_until(lambda line: line["type"] == "estimate")
        statuses.append(await viewer.read_until(lambda line: line["type"] == "status"))

    run(Application(settings), scene)
    assert [statuses[0][part]["state"] for part in ("recorder", "can", "displacement")] == ["off"] * 3
    assert statuses[0]["estimate"]["can_state"] == "absent"
    assert not settings.recording.directory.exists()


def test_a_disk_that_refuses_stops_neither_estimates_nor_the_end(
    short_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (short_path / "recordings").write_text("in the way")
    (short_path / "state").write_text("in the way")
    settings = settings_in(
        short_path, can={"enabled": False}, service={"state_file": str(short_path / "state" / "s.json")}
    )
    viewer = Viewer(settings)

    async def scene() -> None:
        await viewer.read_until(lambda line: line["type"] == "estimate")
        await viewer.read_until(
            lambda line: (
                line["type"] == "status"
                and line["recorder"]["state"] == "waiting"
                and "cannot write to" in line["recorder"]["what"]
                and line["recorder"]["dropped_no_disk"] > 0
            )
        )

    run(Application(settings), scene)
    assert any(line.startswith(f"cannot write {short_path}/state/s.json: ") for line in caplog.messages)


def test_after_a_standstill_frames_wait_for_the_older_samples_of_the_acquiring_process(
    short_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    woken = Application(settings_in(short_path))
    taken: list[tuple[str, Recorded]] = []
    monkeypatch.setattr(woken._stream, "take", lambda topic, record: taken.append((topic, record)))
    behind = [True]
    monkeypatch.setattr(type(woken._imu), "is_behind", property(lambda _: behind[0]))
    late, later = Frame(2_000_000_000, 0x310, bytes(5)), Frame(2_100_000_000, 0x310, bytes(5))
    sample = Burst(1_000_000_000, TimeKind.EDGE, (0,) * 12, None)

    woken._ticked_s -= 5.0  # the loop stood still
    woken._take_frame(late)
    assert taken == []
    woken._blocks.append([sample])
    woken._take_frame(later)
    assert taken == [(topics.IMU_RAW, sample)]
    behind[0] = False
    woken._take_frames()
    assert [record for _, record in taken] == [sample, late, later]


def test_frames_wait_for_nothing_while_the_loop_keeps_time_or_once_their_patience_is_over(
    short_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    running = Application(settings_in(short_path))
    taken: list[Recorded] = []
    monkeypatch.setattr(running._stream, "take", lambda _, record: taken.append(record))
    monkeypatch.setattr(type(running._imu), "is_behind", property(lambda _: True))
    frame = Frame(1, 0x310, bytes(5))
    running._take_frame(frame)
    assert taken == [frame]
    running._ticked_s -= 5.0
    running._take_frame(frame)
    assert taken == [frame]
    running._ticked_s = time.monotonic()
    running._catch_up_until_s = 0.0
    running._take_frames()
    assert taken == [frame, frame]
