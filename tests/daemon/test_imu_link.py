"""The inertial sensor's side of the daemon, in a thread and in a process of its own."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from daemon.imu.link import ImuLink
from daemon.imu.ports import port_openers
from daemon.settings import Settings
from daemon.simulation.virtual import virtual_support
from drivers.acquisition import Block
from drivers.adis16448.burst import Burst
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.identity import Identity
from drivers.clock import SystemClock
from drivers.condition import Wellness
from drivers.data_ready import DataReadyError
from drivers.spi import SpiError

PATIENCE_S = 30.0


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def settings_of(**imu: Any) -> Settings:
    return Settings.model_validate({"imu": {"transport": "virtual"} | imu})


def link_of(settings: Settings, on_block: Callable[[Block], None]) -> ImuLink:
    clock = SystemClock()
    support = None
    if settings.imu.transport == "virtual":
        support = virtual_support(settings, start_ns=clock.now_ns())
    return ImuLink(settings, clock, on_block, support)


@pytest.fixture
def blocks() -> list[Block]:
    return []


@pytest.fixture(params=["thread", "process"])
def link(request: pytest.FixtureRequest, blocks: list[Block]) -> Iterator[ImuLink]:
    link = link_of(settings_of(acquisition=request.param), blocks.append)
    yield link
    link.stop()
    assert not [t for t in threading.enumerate() if t.name.startswith("acquisition")]


def test_samples_come_and_the_link_tells_how_it_is(link: ImuLink, blocks: list[Block]) -> None:
    assert link.condition.word is Wellness.WAITING
    assert link.identity is None
    link.start()
    until(lambda: len(blocks) > 20 and link.identity is not None)
    progress = link.progress
    until(lambda: link.progress > progress)
    link.stop()
    handed_over = len(blocks)
    items = [item for block in blocks for item in block]
    assert items[0] == link.identity
    assert all(isinstance(item, Burst) for item in items[1:])
    counters = json.loads(json.dumps(link.counters()))
    # All that was read was handed over, also what came between the call of stop and the end.
    assert counters["samples"] == len(items) - 1
    assert counters["serial"] == 1234
    assert counters["starts"] == 1
    assert all(counters["faults"].values())
    assert counters["notes"] == []
    time.sleep(0.05)
    assert len(blocks) == handed_over


def test_a_link_that_waits_for_its_port_ends_soon(blocks: list[Block]) -> None:
    settings = settings_of(transport="socket", socket_path="/nowhere/imu")
    link = link_of(settings, blocks.append)
    link.start()
    until(lambda: "start `ramstroke sim` first" in link.condition.what)
    progress = link.progress
    until(lambda: link.progress > progress)
    before = time.monotonic()
    link.stop()
    assert time.monotonic() - before < 5.0
    assert not [t for t in threading.enumerate() if t.name == "acquisition"]
    assert blocks == []


def test_stopping_a_link_that_never_started_is_fine(link: ImuLink) -> None:
    link.stop()


def test_thread_and_process_read_the_same_samples_of_the_same_part(blocks: list[Block]) -> None:
    """Two parts of one seed that begin at the same instant; each side reads its own."""
    start_ns = SystemClock().now_ns() + 2_000_000_000
    words: list[dict[int, tuple[int, ...]]] = []
    for mode in ("process", "thread"):
        settings = settings_of(acquisition=mode)
        support = virtual_support(settings, start_ns=start_ns)
        received: dict[int, tuple[int, ...]] = {}

        def take(block: Block, received: dict[int, tuple[int, ...]] = received) -> None:
            good = [item for item in block if isinstance(item, Burst) and not item.fault]
            received.update({item.t_ns: item.words[1:] for item in good})

        words.append(received)
        link = ImuLink(settings, SystemClock(), take, support)
        link.start()
        if mode == "process":
            held = link
    until(lambda: len(words[0].keys() & words[1].keys()) > 400)
    link.stop()
    held.stop()
    common = words[0].keys() & words[1].keys()
    assert len(common) > 400
    different = [t_ns for t_ns in common if words[0][t_ns] != words[1][t_ns]]
    # The filters start when each part was configured; then the samples are the same to the last bit.
    assert all(t_ns < start_ns + 1_000_000_000 for t_ns in different)


@pytest.mark.parametrize(
    ("imu", "error", "said"),
    [
        ({"transport": "socket", "socket_path": "/nowhere/imu"}, SpiError, "start `ramstroke sim` first"),
        ({"transport": "spidev", "spi_device": "/dev/spidev9.9"}, SpiError, "/dev/spidev9.9"),
    ],
)
def test_a_port_that_is_not_there_is_named(imu: dict[str, str], error: type[Exception], said: str) -> None:
    open_port, _ = port_openers(ImuSettings.model_validate(imu), SystemClock(), None)
    with pytest.raises(error, match=said):
        open_port()


def test_without_a_line_there_is_nothing_to_open_and_with_one_it_is_named() -> None:
    _, open_line = port_openers(ImuSettings(), SystemClock(), None)
    assert open_line is None
    _, open_line = port_openers(ImuSettings(data_ready_line=5, data_ready_chip="/dev/nochip"), SystemClock(), None)
    assert open_line is not None
    with pytest.raises(DataReadyError, match="/dev/nochip"):
        open_line()


def test_the_virtual_part_is_one_however_often_its_port_is_opened() -> None:
    settings = settings_of()
    open_port, open_line = port_openers(settings.imu, SystemClock(), virtual_support(settings, cycles=1))
    assert open_port() is open_port()
    assert open_line is not None
    open_line().close()


def test_a_sensor_served_by_another_program_is_met_when_that_starts(short_path: Path, blocks: list[Block]) -> None:
    from daemon.simulation.virtual import virtual_part
    from drivers.virtual.spi_socket import SpiSocketServer

    path = str(short_path / "imu.sock")
    link = link_of(settings_of(transport="socket", socket_path=path), blocks.append)
    link.start()
    until(lambda: link.condition.word is Wellness.WAITING and path in link.condition.what)
    clock = SystemClock()
    support = virtual_support(settings_of(), start_ns=clock.now_ns())
    server = SpiSocketServer(path, virtual_part(support, clock))
    server.start()
    try:
        until(lambda: len(blocks) > 5)
        assert isinstance(blocks[0][0], Identity)
    finally:
        server.close()
    until(lambda: link.condition.word is Wellness.WAITING)
    link.stop()
