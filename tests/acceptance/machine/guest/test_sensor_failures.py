"""The sensor fails, on the kernel's SPI port and GPIO line: the service says so, and goes on when it is back."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.acceptance.machine.guest.kit import (
    Journal,
    exchange_support,
    run,
    set_fault,
    state_of,
    status,
    wait_for,
)
from tests.acceptance.machine.guest.rows import good_samples, no_good_data_for, row, seconds_to_good_data

pytestmark = pytest.mark.usefixtures("running")


@pytest.fixture(autouse=True)
def well() -> Iterator[None]:
    """Each test begins with a sensor that is well, and leaves no fault behind."""
    wait_for("a sensor that is well", lambda: state_of("imu") == "ok")
    yield
    set_fault("")


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("error", "Input/output error"),
        ("silent", "Connection timed out"),
        ("open", "PROD_ID (0x56) reads 0xFFFF"),
    ],
)
def test_transfers_fail(fault: str, said: str, journal: Journal) -> None:
    set_fault(fault)
    journal.wait_for(said)
    assert no_good_data_for(3.0)
    set_fault("")
    row(f"SPI: {fault}", journal, seconds_to_good_data())


def test_transfers_are_answered_late(journal: Journal) -> None:
    """Half a second late: of those samples that are read none is bad, but most are missed."""
    set_fault("late 0.5")
    journal.wait_for("samples are missed")
    set_fault("")
    row("SPI: late 0.5", journal, seconds_to_good_data())


def test_nobody_is_behind_the_port(journal: Journal) -> None:
    run("systemctl", "stop", "machine-support")
    journal.wait_for("Input/output error")
    exchange_support()
    row("SPI server stopped and started", journal, seconds_to_good_data())


def test_another_product_answers(journal: Journal) -> None:
    set_fault("product 0x4041")
    run("systemctl", "stop", "machine-support")
    journal.wait_for("Input/output error")
    exchange_support()
    journal.wait_for("0x4041")
    assert no_good_data_for(3.0)
    set_fault("")
    row("wrong product identification", journal, seconds_to_good_data())


def test_the_line_falls_silent(journal: Journal) -> None:
    """Reads are then paced by the clock: good data go on."""
    set_fault("edges")
    journal.wait_for("data-ready line is silent")
    paced = int(status()["imu"]["paced_reads"])
    seconds = seconds_to_good_data()
    wait_for("paced reads", lambda: int(status()["imu"]["paced_reads"]) > paced)
    set_fault("")
    edges = int(status()["imu"]["edge_reads"])
    wait_for("reads at edges", lambda: int(status()["imu"]["edge_reads"]) > edges + 10)
    row("data-ready stops", journal, seconds)


def test_the_sensor_is_well_at_the_end() -> None:
    wait_for("a sensor that is well", lambda: state_of("imu") == "ok")
    assert good_samples() > 0
