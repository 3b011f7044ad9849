"""Every part with every setting: it starts, reads back as set, and samples with the right scale and rate."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers.adis16448.burst import BurstDecoder
from drivers.adis16448.machine import State
from drivers.condition import OK
from drivers.virtual.inertial_input import SteadyInput
from tests.drivers.inertial_kit import Bench, bursts, good

GYRO, ACCEL = (0.1234, -0.5, 3.0), (1.0, -2.5, 9.7)
RATE_HZ = 830.0
# Typed from the data sheet: range code, LSB [deg/s], least taps exponent.
RANGES = {1000: (0x4, 0.04, 0), 500: (0x2, 0.02, 2), 250: (0x1, 0.01, 4)}


@pytest.mark.parametrize("silicon", ["BMLZ", "AMLZ"])
@pytest.mark.parametrize("decimation", range(6))
@pytest.mark.parametrize("gyro_range", RANGES)
def test_every_combination_works(silicon: str, decimation: int, gyro_range: int) -> None:
    code, lsb_dps, least_taps = RANGES[gyro_range]
    decoder = BurstDecoder(gyro_range)
    for taps in range(least_taps, 8):
        settings = {
            "gyro_range_dps": gyro_range,
            "filter_taps_exponent": taps,
            "decimation_exponent": decimation,
            "block_samples": 4,
        }
        source = SteadyInput(RATE_HZ, gyro=GYRO, accel=ACCEL, temperature_c=40.0)
        bench = Bench(settings, source, silicon=silicon, errors=None)
        bench.run_to(State.RUN)
        memory = bench.part._memory
        assert (memory.get(0x38), memory.get(0x36)) == (code << 8 | taps, decimation << 8 | 1)
        assert memory.get(0x34) == (0x0016 if silicon == "BMLZ" else 0x0006)
        items = bench.step() + bench.step()
        read = bursts(items)
        assert len(good(items)) == len(read) >= 4
        assert np.diff([burst.t_ns for burst in read]) == pytest.approx(1e9 * 2**decimation / RATE_HZ, abs=2)
        assert {burst.crc is None for burst in read} == {silicon == "AMLZ"}
        sample = decoder.sample(read[-1])
        assert sample.gyro == pytest.approx(GYRO, abs=math.radians(lsb_dps) / 2 * 1.0001)
        assert sample.accel == pytest.approx(ACCEL, abs=9.80665 / 2400 * 1.0001)
        assert sample.temperature_c == pytest.approx(40.0, abs=0.03694)
        assert decoder.pressure_pa(read[-1]) == 100_000
        assert bench.sensor.condition == OK or bench.sensor.condition.advice == ""


@pytest.mark.parametrize("pin", [1, 2])
@pytest.mark.parametrize("active_high", [True, False])
def test_both_data_ready_pins_work_with_an_inverter_and_without(pin: int, active_high: bool) -> None:
    bench = Bench({"data_ready_pin": pin, "data_ready_active_high": active_high})
    bench.run(1.0)
    items = bench.run(1.0)
    assert len(good(items)) == len(items)
    assert bench.sensor.counters.paced_reads == 0
    assert bench.sensor.condition == OK
