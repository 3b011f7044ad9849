"""What most files here begin with: the service with its sensor and its bus, and the journal from then on."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.acceptance.machine.guest.kit import Journal, properties, set_up, start_service
from tests.acceptance.machine.guest.rows import good_readings, seconds_to_good_data


@pytest.fixture(scope="module")
def running() -> Iterator[None]:
    """The service brings good data; one start for all tests of a file, and none by the watchdog."""
    set_up()
    start_service()
    seconds_to_good_data()
    seconds_to_good_data(good_readings)
    yield
    assert properties("NRestarts", "ActiveState") == {"NRestarts": "0", "ActiveState": "active"}


@pytest.fixture
def journal() -> Iterator[Journal]:
    """From the beginning of the test on."""
    journal = Journal()
    yield journal
    journal.close()
