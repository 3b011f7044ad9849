"""What a fault script does to the readings of the controller's displacement sensor."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from drivers.virtual.controller import Observation
from drivers.virtual.faults import (
    Delayed,
    Drift,
    FaultScript,
    Jump,
    NoiseBurst,
    Placed,
    SensorError,
    StuckValue,
    ValueFault,
    placed,
)


def faulty_observations(
    observations: Iterable[Observation], script: FaultScript, start_ns: int
) -> Iterator[Observation]:
    """The readings with the faults of the script, which act one after the other, in its order."""
    places: list[Placed[ValueFault]] = placed(
        script, start_ns, StuckValue, Jump, Drift, NoiseBurst, SensorError, Delayed
    )
    generators = [place.generator() for place in places]
    stuck: dict[bytes, float] = {}
    last_sent_ns = 0
    for t_ns, true_value_m in observations:
        value_m, latency_s = true_value_m, 0.0
        for place, generator in zip(places, generators, strict=True):
            if not place.holds(t_ns):
                continue
            fault = place.fault
            if isinstance(fault, StuckValue):
                value_m = stuck.setdefault(place.key, value_m)
            elif isinstance(fault, Jump):
                value_m += fault.offset_mm / 1e3
            elif isinstance(fault, Drift):
                value_m += fault.mm_s / 1e3 * (t_ns - place.start_ns) / 1e9
            elif isinstance(fault, NoiseBurst):
                value_m += generator.gauss(0.0, fault.sigma_mm / 1e3)
            elif isinstance(fault, SensorError):
                value_m = math.nan
            else:
                latency_s += fault.latency_ms / 1e3
        # A gateway keeps the order: what follows a late reading waits for it.
        last_sent_ns = max(last_sent_ns, t_ns + round(latency_s * 1e9))
        yield last_sent_ns, value_m
