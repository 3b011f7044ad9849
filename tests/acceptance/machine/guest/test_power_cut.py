"""The power fails in the middle of a push. The disk outlasts this, and `test_after_power_cut.py` looks at it."""

from __future__ import annotations

import os

from tests.acceptance.machine.guest.kit import (
    Journal,
    run,
    set_up,
    start_service,
    status,
    wait_for,
)


def test_the_power_is_cut_in_the_middle_of_a_push() -> None:
    set_up()
    run("systemctl", "enable", "--quiet", "ramstroke")
    run("sync")
    journal = Journal()
    start_service()
    journal.wait_for("start confirmed (push)")
    wait_for("the middle of the push", lambda: status()["estimate"]["displacement_mm"] > 200.0)
    port = os.open("/dev/port", os.O_RDWR)
    os.lseek(port, 0xF4, os.SEEK_SET)
    os.write(port, b"\x00")  # nothing is written to the disk any more
