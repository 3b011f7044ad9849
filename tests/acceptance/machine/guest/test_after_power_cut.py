"""After the power cut: the service starts by itself, what was recorded is whole, the stroke is found again."""

from __future__ import annotations

import json

from tests.acceptance.machine.guest.kit import (
    RAMSTROKE,
    RECORDINGS,
    Journal,
    add_bus,
    load_devices,
    properties,
    run,
    start_support,
    status,
    wait_for,
)
from tests.acceptance.machine.guest.rows import row, seconds_to_good_data


def test_the_service_goes_on_after_a_power_cut() -> None:
    journal = Journal()
    load_devices()
    add_bus()
    start_support()
    wait_for("the service", lambda: properties("ActiveState")["ActiveState"] == "active", 300.0)
    seconds = seconds_to_good_data()
    row("power cut in the middle of a push", journal, seconds)
    estimate = wait_for("a stroke", lambda: status()["estimate"])
    assert estimate["sigma_mm"] < 100.0


def test_what_was_recorded_is_whole_to_the_last_second() -> None:
    first = min(RECORDINGS.glob("*.mcap"))
    replayed = json.loads(run(RAMSTROKE, "replay", first, "--json"))
    assert replayed["identical"] is True
    assert replayed["samples"] > 300
