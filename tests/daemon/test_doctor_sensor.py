"""The doctor finds what is wrong with an ADIS16448 and its wires, and calls a healthy one healthy."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from daemon.doctor import sampling
from daemon.doctor.report import Verdict
from drivers.adis16448.registers import STANDARD_GRAVITY
from drivers.clock import Clock
from drivers.data_ready import DataReadyError, Edge
from drivers.virtual.inertial_input import SteadyInput
from drivers.virtual.sensor_errors import SensorGrade
from estimation.records import TimeKind
from tests.daemon.doctor_kit import Bench, assert_told_in_sentences, names_of


def test_a_healthy_part_is_healthy(tmp_path: Path) -> None:
    checks = Bench(tmp_path).examine()
    assert set(checks) >= {"SPI port", "sensor", "self-test", "data-ready line", "samples", "up axis", "temperature"}
    assert {check.verdict for check in checks.values()} == {Verdict.OK}
    assert checks["sensor"].figures["serial"] == 1234
    assert checks["sample rate"].figures["rate_hz"] == pytest.approx(819.2, rel=1e-3)
    assert checks["data-ready line"].figures["edges_not_driven_hz"] == 0
    assert "--estimate-mount" in checks["up axis"].found
    assert_told_in_sentences(list(checks.values()))


@pytest.mark.parametrize(
    ("fault", "reads", "wire"),
    [
        ({"kind": "miso_low"}, "all zeros", "DOUT, MISO) stays low"),
        ({"kind": "miso_high"}, "all ones", "DOUT, MISO) floats"),
        ({"kind": "bit_flips", "probability": 0.02}, "wandering", "contact"),
        ({"kind": "wrong_product_id"}, "another part", "fit an ADIS16448"),
        ({"kind": "wrong_product_id", "product_id": 0x8080}, "wrong", "SCLK"),
        ({"kind": "wrong_product_id", "product_id": 0x1234}, "wrong", "SCLK, DIN (MOSI) and CS"),
    ],
    ids=["dead low", "dead high", "wandering", "another part", "shifted", "wrong"],
)
def test_wires_that_are_wrong_are_named(fault: dict[str, Any], reads: str, wire: str, tmp_path: Path) -> None:
    checks = Bench(tmp_path, fault).examine()
    assert names_of(checks, Verdict.FAULT) == ["sensor"]
    assert checks["sensor"].figures["reads"] == reads
    assert wire in checks["sensor"].advice
    assert checks["up axis"].verdict is Verdict.NOT_CHECKED
    assert_told_in_sentences(list(checks.values()))


def test_a_port_that_fails_is_told(tmp_path: Path) -> None:
    checks = Bench(tmp_path, {"kind": "spi_error"}).examine()
    assert names_of(checks, Verdict.FAULT) == ["SPI transfers"]
    assert checks["sensor"].verdict is Verdict.NOT_CHECKED


def test_a_failed_self_test_hides_nothing_behind_it(tmp_path: Path) -> None:
    checks = Bench(tmp_path, {"kind": "self_test_failure", "parts": ["y_gyro"]}).examine()
    assert names_of(checks, Verdict.FAULT) == ["self-test"]
    assert "the y gyroscope failed" in checks["self-test"].found
    assert checks["sample rate"].verdict is Verdict.OK


def test_steel_nearby_is_no_fault(tmp_path: Path) -> None:
    checks = Bench(tmp_path, {"kind": "self_test_failure", "parts": ["magnetometer"]}).examine()
    assert checks["self-test"].verdict is Verdict.OK
    assert "magnetometer" in checks["self-test"].found


# --- the data-ready line --------------------------------------------------------------------------------------


@dataclass
class Stranger:
    """A line that ticks whatever the part does."""

    clock: Clock
    rate_hz: float

    def __post_init__(self) -> None:
        self._last = self._number()

    def wait(self, timeout_s: float) -> Edge | None:
        if self._number() == self._last:
            self.clock.sleep(timeout_s)
        number = self._number()
        if number == self._last:
            return None
        missed, self._last = number - self._last - 1, number
        return Edge(round(number * 1e9 / self.rate_hz), TimeKind.EDGE, missed)

    def close(self) -> None:
        pass

    def _number(self) -> int:
        return int(self.clock.now_ns() * 1e-9 * self.rate_hz)


def test_a_silent_line_is_found_and_the_part_still_read(tmp_path: Path) -> None:
    checks = Bench(tmp_path, {"kind": "data_ready_lost"}).examine()
    assert names_of(checks, Verdict.FAULT) == ["data-ready line"]
    assert "silent" in checks["data-ready line"].found
    assert "DIO1" in checks["data-ready line"].advice
    assert checks["sample rate"].verdict is Verdict.NOT_CHECKED
    assert checks["gravity"].verdict is Verdict.OK


@pytest.mark.parametrize("rate_hz", [50.0, 819.2, 5000.0])
def test_a_line_that_ticks_for_another_reason_is_found_out(rate_hz: float, tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    checks = bench.examine(lambda: Stranger(bench.patient.clock, rate_hz))
    assert checks["data-ready line"].verdict is Verdict.FAULT
    assert "another reason" in checks["data-ready line"].found


def test_the_other_pin_of_the_part_is_recognised(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    checks = bench.examine(lambda: bench.part.data_ready(pin=2))
    assert checks["data-ready line"].verdict is Verdict.FAULT
    assert "set data_ready_pin = 2 in [imu]" in checks["data-ready line"].advice


@pytest.mark.parametrize("active_high", [True, False])
def test_an_inverter_in_the_line_is_found(active_high: bool, tmp_path: Path) -> None:
    bench = Bench(tmp_path, imu={"data_ready_active_high": active_high})
    checks = bench.examine(lambda: bench.part.data_ready(active_high=False))
    assert names_of(checks, Verdict.FAULT) == ["data-ready line"]
    assert "inverted" in checks["data-ready line"].found
    assert f"data_ready_active_high = {str(not active_high).lower()}" in checks["data-ready line"].advice
    assert bench.examine()["data-ready line"].verdict is Verdict.OK


def test_lost_and_doubled_edges_are_told(tmp_path: Path) -> None:
    lost = Bench(tmp_path, {"kind": "data_ready_lost", "share": 0.3}).examine()["data-ready line"]
    assert (lost.verdict, lost.found.split(":")[0]) == (Verdict.FAULT, "edges are lost")
    rings = Bench(tmp_path, {"kind": "data_ready_doubled"}).examine()["data-ready line"]
    assert (rings.verdict, rings.found.split(":")[0]) == (Verdict.WARNING, "edges are too many")


def test_without_a_line_that_is_said(tmp_path: Path) -> None:
    checks = Bench(tmp_path).examine(None)
    assert checks["data-ready line"].verdict is Verdict.WARNING
    assert names_of(checks, Verdict.FAULT) == []


def test_a_line_that_cannot_be_opened_is_a_fault(tmp_path: Path) -> None:
    def busy() -> Any:
        raise DataReadyError(
            "cannot watch line 25 of /dev/gpiochip0 for data-ready: [Errno 16] Device or resource busy; "
            "set data_ready_chip and data_ready_line"
        )

    checks = Bench(tmp_path).examine(busy)
    assert names_of(checks, Verdict.FAULT) == ["data-ready line"]
    assert "busy" in checks["data-ready line"].found
    assert "gpioinfo" in checks["data-ready line"].advice


def test_the_part_is_left_as_it_was_configured(tmp_path: Path) -> None:
    from drivers.adis16448.device import Adis16448
    from drivers.adis16448.probe import line_reaction

    bench = Bench(tmp_path, imu={"data_ready_pin": 2})
    device = Adis16448(bench.part, bench.patient.clock, bench.patient.settings.imu)
    device.configure()
    before = device.read_register("MSC_CTRL")
    line_reaction(device, bench.line(), bench.patient.clock, 1, 0.05)
    assert device.read_register("MSC_CTRL") == before


# --- samples --------------------------------------------------------------------------------------------------


def test_a_bad_contact_shows_in_the_checksums(tmp_path: Path) -> None:
    bench = Bench(tmp_path, {"kind": "bit_flips", "probability": 2e-3, "at_s": 1.0})
    check = bench.examine()["samples"]
    assert check.verdict in (Verdict.WARNING, Verdict.FAULT)
    assert check.found.startswith("samples fail their checksum")
    assert "SCLK" in check.advice


def test_a_part_that_hangs_is_told(tmp_path: Path) -> None:
    checks = Bench(tmp_path, {"kind": "repeated_samples"}).examine()
    assert Verdict.FAULT in {checks["samples"].verdict, checks["noise at rest"].verdict}


def test_a_noisy_part_is_told(tmp_path: Path) -> None:
    grade = SensorGrade(gyro_noise_density=math.radians(0.0135) * 12)
    check = Bench(tmp_path, grade=grade).examine()["noise at rest"]
    assert check.verdict is Verdict.WARNING
    assert max(check.figures["times_sheet"]) == pytest.approx(12, rel=0.2)


def test_a_dead_axis_is_told(tmp_path: Path) -> None:
    grade = SensorGrade(gyro_noise_density=0.0)
    check = Bench(tmp_path, grade=grade).examine()["noise at rest"]
    assert check.verdict is Verdict.WARNING
    assert "may be dead" in check.advice


@pytest.mark.parametrize(
    ("up", "verdict", "advice"),
    [
        ("+z", Verdict.OK, "nothing to do"),
        ("-z", Verdict.FAULT, 'set up = "+z"'),
        ("+x", Verdict.FAULT, 'set up = "+z"'),
    ],
)
def test_the_wrong_axis_up_is_found(up: str, verdict: Verdict, advice: str, tmp_path: Path) -> None:
    check = Bench(tmp_path, mount={"up": up}).examine()["up axis"]
    assert check.verdict is verdict
    assert advice in check.advice


def test_a_tilted_sensor_is_a_warning_until_the_tilt_is_configured(tmp_path: Path) -> None:
    tilt = math.radians(25)
    force = (0.0, STANDARD_GRAVITY * math.sin(tilt), STANDARD_GRAVITY * math.cos(tilt))
    assert Bench(tmp_path, source=SteadyInput(accel=force)).examine()["up axis"].verdict is Verdict.WARNING
    for pitch_deg in (25.0, -25.0):
        bench = Bench(tmp_path, source=SteadyInput(accel=force), mount={"pitch_deg": pitch_deg})
        if bench.examine()["up axis"].verdict is Verdict.OK:
            return
    pytest.fail("no tilt makes it level")


def test_biases_beyond_the_data_sheet_are_told(tmp_path: Path) -> None:
    turned = Bench(tmp_path, source=SteadyInput(gyro=(0.0, math.radians(3.0), 0.0))).examine()
    assert turned["gyroscopes at rest"].verdict is Verdict.WARNING
    spinning = Bench(tmp_path, source=SteadyInput(gyro=(0.0, math.radians(30.0), 0.0))).examine()
    assert spinning["gyroscopes at rest"].verdict is Verdict.FAULT
    heavy = Bench(tmp_path, source=SteadyInput(accel=(0.0, 0.0, 14.0))).examine()
    assert heavy["gravity"].verdict is Verdict.FAULT
    hot = Bench(tmp_path, source=SteadyInput(temperature_c=110.0)).examine()
    assert hot["temperature"].verdict is Verdict.WARNING


def test_another_rate_than_the_data_sheet_is_told(tmp_path: Path) -> None:
    check = Bench(tmp_path, source=SteadyInput(770.0)).examine()["sample rate"]
    assert check.verdict is Verdict.WARNING
    assert check.figures["off"] == pytest.approx(770 / 819.2 - 1, abs=1e-3)


@pytest.mark.parametrize("imu", [{"decimation_exponent": 5}, {"filter_taps_exponent": 5}, {"gyro_range_dps": 1000}])
def test_other_settings_are_judged_by_their_own_noise_and_rate(imu: dict[str, Any], tmp_path: Path) -> None:
    checks = Bench(tmp_path, imu=imu).examine()
    assert {check.verdict for check in checks.values()} == {Verdict.OK}


def test_samples_are_read_with_the_priority_that_the_daemon_would_have(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, str]] = []
    monkeypatch.setattr(
        sampling, "prefer_this_thread", lambda priority: asked.append((priority, threading.current_thread().name))
    )
    checks = Bench(tmp_path, imu={"realtime_priority": 40}).examine()
    assert checks["samples"].verdict is Verdict.OK
    assert [priority for priority, _ in asked] == [40]
    assert asked[0][1] != threading.main_thread().name
