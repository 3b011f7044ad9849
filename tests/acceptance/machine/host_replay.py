"""The machine's recording replayed on the host, whose processor and BLAS round otherwise."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from daemon.offline.replaying.replay import replay
from daemon.recording import topics
from daemon.recording.reader import Recording
from daemon.recording.topics import Recorded
from estimation.records import Estimate

# Measured: displacement and sigma are the same to the last bit; what differs are velocity steps, by 1e-13 m/s.
TOLERANCE_MM = 1e-6
_COMPARED = (topics.PROVISIONAL, topics.SETTLED)


def largest_difference_mm(path: Path) -> float:
    """Between displacements and sigmas recorded in the machine and those of a replay here.

    Raises ValueError if they are not of the same steps.
    """
    recorded: dict[str, list[Estimate]] = defaultdict(list)
    computed: dict[str, list[Estimate]] = defaultdict(list)

    def receive(topic: str, record: Recorded) -> None:
        if isinstance(record, Estimate):
            computed[topic].append(record)

    replay(path, sink=receive)
    for topic, record in Recording(path).messages(_COMPARED):
        assert isinstance(record, Estimate)
        recorded[topic].append(record)
    largest_m = 0.0
    for topic in _COMPARED:
        there, here = recorded[topic], computed[topic]
        if not there or [one.t_ns for one in there] != [one.t_ns for one in here]:
            raise ValueError(f"{topic}: {len(there)} estimates recorded, {len(here)} computed, at different times")
        for a, b in zip(there, here, strict=True):
            largest_m = max(largest_m, abs(a.displacement_m - b.displacement_m), abs(a.sigma_m - b.sigma_m))
    return largest_m * 1e3
