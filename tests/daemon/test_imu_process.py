"""The acquiring process: killed, hung, orphaned, stalled behind a slow parent."""

from __future__ import annotations

import itertools
import os
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from daemon.imu import process as imu_process
from daemon.imu.child import Outbox
from daemon.imu.messages import Health, LogLine, Message, Orders, receive, send
from daemon.imu.process import ImuProcess
from daemon.settings import Settings
from drivers.acquisition import Block
from drivers.adis16448.burst import Burst
from drivers.adis16448.counters import Counters
from drivers.adis16448.identity import Identity
from drivers.clock import SystemClock
from drivers.condition import OK, Wellness
from drivers.jy901.identity import Jy901Identity
from estimation.records import TimeKind

PATIENCE_S = 30.0
SETTINGS = Settings.model_validate({"imu": {"transport": "virtual", "acquisition": "process"}})


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def is_alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def burst(number: int) -> Burst:
    return Burst(number, TimeKind.EDGE, (number & 0xFFFF,) * 12, None)


@pytest.fixture
def blocks() -> list[Block]:
    return []


@pytest.fixture
def process(blocks: list[Block], monkeypatch: pytest.MonkeyPatch) -> Iterator[ImuProcess]:
    monkeypatch.setattr(imu_process, "FIRST_RETRY_S", 0.02)
    monkeypatch.setattr(imu_process, "HANG_S", 1.5)
    process = ImuProcess(SETTINGS, SystemClock().now_ns(), blocks.append)
    process.start()
    until(lambda: len(blocks) > 5 and process.condition == OK)
    yield process
    pid = process.pid
    process.stop()
    assert pid is None or not is_alive(pid)


@pytest.mark.parametrize(("harm", "said"), [(signal.SIGKILL, "ended (signal 9)"), (signal.SIGSTOP, "hung")])
def test_a_process_that_dies_or_hangs_is_named_and_replaced_and_its_counters_are_kept(
    process: ImuProcess, blocks: list[Block], harm: signal.Signals, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    samples, first = process.counters.samples, process.pid
    assert first is not None
    os.kill(first, harm)
    until(lambda: process.pid not in (None, first))
    until(lambda: process.counters.starts == 2 and process.counters.samples > samples + 400)
    assert process.own_counters()["process_restarts"] == 1
    assert process.condition.word is not Wellness.WAITING
    assert not is_alive(first)
    assert any(f"the acquisition process {said}" in line for line in caplog.messages)
    assert sum(isinstance(item, Identity) for block in blocks for item in block) == 2


def test_ctrl_c_in_the_terminal_is_the_parents_business(process: ImuProcess, blocks: list[Block]) -> None:
    assert process.pid is not None
    os.kill(process.pid, signal.SIGINT)
    received = len(blocks)
    until(lambda: len(blocks) > received + 20)
    assert process.own_counters()["process_restarts"] == 0


def test_a_parent_that_stalls_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    items: Block = []
    is_stalled, go_on = threading.Event(), threading.Event()

    def take(block: Block) -> None:
        items.extend(block)
        if len(items) > 100 and not is_stalled.is_set():
            is_stalled.set()
            go_on.wait(PATIENCE_S)

    process = ImuProcess(SETTINGS, SystemClock().now_ns(), take)
    process.start()
    assert is_stalled.wait(PATIENCE_S)
    time.sleep(2.5)  # 2000 samples: more than the pipe holds
    go_on.set()
    until(lambda: len(items) > 2500)
    process.stop()
    bursts = [item for item in items if isinstance(item, Burst)]
    counters = process.counters
    assert counters.samples == len(bursts)
    assert process.own_counters()["dropped"] == 0
    distances_ns = [b.t_ns - a.t_ns for a, b in itertools.pairwise(bursts)]
    # The part's own clock: a busy computer misses so many in a row that 3 % would be a sample.
    period_ns = statistics.median(distances_ns)
    steps = [round(distance_ns / period_ns) for distance_ns in distances_ns]
    missed = sum(steps) - len(steps)
    # Some may have passed between the end of the start and the first read.
    assert missed <= counters.missed <= missed + 0.1 / (period_ns * 1e-9)


def test_no_orphan_remains_when_the_parent_is_killed() -> None:
    program = (
        "import sys, time\n"
        "from daemon.imu.process import ImuProcess\n"
        "from daemon.settings import Settings\n"
        f"settings = Settings.model_validate_json({SETTINGS.model_dump_json()!r})\n"
        "process = ImuProcess(settings, time.monotonic_ns(), lambda block: print(process.pid, flush=True))\n"
        "process.start()\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert is_alive(child)
        parent.kill()
        parent.wait()
    until(lambda: not is_alive(child))


def test_a_process_that_cannot_be_started_is_tried_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(imu_process, "FIRST_RETRY_S", 0.01)
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    process = ImuProcess(SETTINGS, 0, lambda _: None)
    process.start()
    until(lambda: process.own_counters()["process_restarts"] >= 2)
    progress = process.progress
    until(lambda: process.progress > progress)
    assert process.condition.word is Wellness.WAITING
    process.stop()
    assert any("cannot be started" in line for line in caplog.messages)


def test_messages_arrive_as_they_were_sent_whatever_their_size() -> None:
    health = Health(OK, Counters(samples=3), Identity(1, 2, 3, 4), ["note"], 5, 6)
    sent: list[Message] = [
        Orders("{}", 7),
        health,
        LogLine("a", 20, "b"),
        [Identity(1, 2, 3, 4), *map(burst, range(5000))],
    ]
    reading, writing = os.pipe()

    def send_all() -> None:
        for message in sent:
            send(writing, message)
        os.close(writing)

    thread = threading.Thread(target=send_all)
    thread.start()
    received = [receive(reading, PATIENCE_S) for _ in sent]
    assert received == sent
    assert receive(reading, PATIENCE_S) is None
    thread.join()
    os.close(reading)


def test_a_message_that_stops_half_way_does_not_hold_the_reader_for_ever() -> None:
    reading, writing = os.pipe()
    os.write(writing, b"\x00\x00\x00\x10half")
    with pytest.raises(TimeoutError):
        receive(reading, 0.05)
    os.close(writing)
    assert receive(reading, 0.05) is None
    os.close(reading)


def test_a_full_buffer_drops_the_oldest_samples_counts_them_and_keeps_who_they_were_of() -> None:
    outbox = Outbox(most_samples=100)
    identity = Identity(0, 16448, 1, 2)
    outbox.put([identity, burst(0), burst(1)])
    for first in range(2, 202, 8):
        outbox.put([burst(number) for number in range(first, first + 8)])
    outbox.put_line(LogLine("a", 20, "told first"))
    line, *blocks = outbox.take(0.0)
    assert line == LogLine("a", 20, "told first")
    items = [item for block in blocks if isinstance(block, list) for item in block]
    assert items[0] == identity
    kept = [item.t_ns for item in items[1:]]
    assert kept == list(range(kept[0], 202))
    assert 92 <= len(kept) <= 100
    assert outbox.dropped == 202 - len(kept)
    assert outbox.take(0.0) == []


def test_a_jy901_is_read_in_a_process_too(blocks: list[Block]) -> None:
    chosen = Settings.model_validate(
        {"imu": {"acquisition": "process"}, "jy901": {"use": "instead", "transport": "virtual"}}
    )
    process = ImuProcess(chosen, SystemClock().now_ns(), blocks.append)
    process.start()
    try:
        until(lambda: sum(map(len, blocks)) > 100)
        until(lambda: process.counters.samples > 0)
        assert isinstance(blocks[0][0], Jy901Identity)
        assert process.condition.word in (Wellness.OK, Wellness.ILL)
        assert process.own_counters()["process_restarts"] == 0
    finally:
        process.stop()
