"""Each kind of fault by itself, in mid-push: counted, said, outlived, honest in sigma, and replayed bit for bit."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest

from drivers.virtual.faults import KINDS
from tests.acceptance.fault_scene import without_faults
from tests.fault_table import row_of


class Expected(NamedTuple):
    """What must be counted and said of a fault, and which share of the sources' data must come all the same."""

    counter: str = ""  # at least once more than without the fault
    said: str = ""  # part of a sentence
    samples: float = 0.999  # share of the good samples while it lasts, at least
    readings: float = 0.85  # of the valid readings
    state: str = ""  # of the displacement sensor
    sigma_grows: bool = False


def dead(counter: str, said: str) -> Expected:
    """No good sample comes meanwhile."""
    return Expected(counter, said, samples=0.0, sigma_grows=True)


def mute(counter: str, said: str, state: str) -> Expected:
    """No valid reading comes meanwhile."""
    return Expected(counter, said, readings=0.0, state=state)


EXPECTED = {
    "miso_low": dead("all_zero", "samples are all zeros"),
    "miso_high": dead("all_one", "samples are all ones"),
    "bit_flips": Expected("crc", "fail their checksum", samples=0.7),
    "brown_out": dead("wrong_id", "the part was started anew"),
    "data_ready_lost": Expected("paced_reads", "the data-ready line is silent", samples=0.95),
    "data_ready_doubled": Expected("repeated", "samples come twice"),
    "spi_error": dead("spi", "the SPI port"),
    "slow_spi": Expected("torn", "samples are", samples=0.5),
    "repeated_samples": Expected("repeated", "the sensor stands still", samples=0.0),
    "self_test_failure": dead("failed_self_tests", "the x gyroscope failed its self-test"),
    "wrong_product_id": dead("wrong_id", "reads 0x403D instead of 0x4040"),
    "unplugged": dead("all_one", "samples are all ones"),
    "replaced": dead("other_parts", "samples are all ones"),
    "overrange": Expected("a sensor is beyond its range", "a sensor is beyond its range", samples=0.0),
    "late_edges": Expected("missed", "samples are missed", samples=0.0),
    "serial_cut": dead("silences", "nothing comes on the serial line"),
    "serial_drops": Expected("halves", "samples are lost on the serial line", samples=0.5),
    "serial_flips": Expected("bad_checksums", "samples are lost on the serial line", samples=0.6),
    "serial_garbage": Expected("skipped_bytes", samples=0.9),
    "serial_heaps": Expected(),
    "adapter_gone": dead("port_failures", "the serial port of the virtual JY901 is gone"),
    "jy901_brown_out": dead("starts", "bytes come that are no samples"),
    "jy901_frozen": dead("frozen", "the samples stand still"),
    "jy901_dead_band": Expected(),
    "can_silence": mute("", "no frame 0x310 for", "silent"),
    "stuck_value": Expected("", "stands still although the ram moves", state="stuck"),
    "jump": Expected("", "does not fit the motion", state="biased"),
    "drift": Expected("", "does not fit the motion", state="biased"),
    "noise_burst": Expected(),
    "sensor_error": mute("invalid", "the source says: invalid", "invalid"),
    "delayed": Expected(),
    "wrong_identifier": mute("", "no frame 0x310 for", "silent"),
    "wrong_length": mute("malformed", "have 1 bytes instead of 5", "invalid"),
    "corrupted": mute("checksum", "the checksum of frames 0x310 does not fit", "invalid"),
    "frozen_frame": mute("repeated", "the message counter stands still", "stuck"),
    "error_frames": Expected("error_frames", "error frames on"),
    "bus_off": mute("bus-off", "is bus-off", "silent"),
    "flood": Expected("crowded_frames", "the message counter stands still"),
    "interface_down": mute("reconnects", "is down", "silent"),
    "interface_deleted": mute("reconnects", "there is no network interface", "silent"),
}
LONGEST_RECOVERY_S = 2.5  # a port that is tried again, a part that is reset, tested and set up


def test_every_kind_has_its_expectation() -> None:
    assert EXPECTED.keys() == KINDS.keys()


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_counted_said_and_outlived(kind: str, tmp_path: Path) -> None:
    expected, row = EXPECTED[kind], row_of(kind, tmp_path)
    if expected.counter:
        assert row.counted.get(expected.counter, 0) > 0, row.counted
    assert expected.said in "\n".join(row.said)
    assert row.samples >= expected.samples * row.samples_without
    assert row.readings >= expected.readings * row.readings_without
    # The other side goes on as if nothing had happened.
    assert row.samples == row.samples_without or row.readings >= 0.9 * row.readings_without
    assert row.good_again_s < LONGEST_RECOVERY_S
    if expected.state:
        assert expected.state in row.states
    if expected.sigma_grows:
        assert row.sigma_mm > 1.5 * row.sigma_without_mm
    assert row.worst_sigmas < 4.0
    assert row.identical


def test_without_faults_nothing_is_complained_of() -> None:
    outcome = without_faults()
    assert [condition.what for t_s, _, condition in outcome.said if t_s > 1.0] == []
    assert len(outcome.moves) == 1
