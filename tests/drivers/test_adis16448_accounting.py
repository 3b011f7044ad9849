"""Nothing is lost silently: every edge of the part is a sample read, a sample missed, or passed during a start."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.virtual.adis16448 import VirtualAdis16448
from tests.drivers.inertial_kit import Bench, Lossy, bursts, flip_bit, good, on_bursts

TROUBLES = st.sampled_from(
    [
        "none",
        "stall",
        "zeros",
        "ones",
        "noise",
        "brown-out",
        "port",
        "cut line",
        "line too",
        "slow reads",
        "lost edges",
    ]
)


def edges_of(part: VirtualAdis16448) -> int:
    return part.account().edges


@settings(derandomize=True, deadline=None, max_examples=40)
@given(st.lists(st.tuples(TROUBLES, st.floats(0.001, 1.5)), max_size=6), st.sampled_from([0, 1, 4]))
def test_edges_are_read_or_missed_or_passed_during_a_start(troubles: list[tuple[str, float]], decimation: int) -> None:
    edge_wire = Lossy(0.0)
    bench = Bench({"decimation_exponent": decimation}, edge_wire=edge_wire)
    items = bench.run(0.5)
    transfer = bench.part.transfer
    for trouble, seconds in troubles:
        bench.part.stuck_byte = {"zeros": 0x00, "ones": 0xFF, "line too": 0x00}.get(trouble)
        bench.part.is_line_cut = trouble in ("cut line", "line too")
        bench.wire.tamper = on_bursts(flip_bit) if trouble == "noise" else lambda _, answer: answer
        bench.wire.error = bench.wire.open_error = "the port is gone" if trouble == "port" else ""
        edge_wire.share = 0.6 if trouble == "lost edges" else 0.0
        if trouble == "brown-out":
            bench.part._memory.restart()
            bench.part._update_signal(bench.clock.now_ns())
        elif trouble == "stall":
            bench.clock.sleep(seconds)
        elif trouble == "slow reads":

            def slow(data: bytes, speed_hz: int) -> bytes:
                bench.clock.sleep(0.001)
                return transfer(data, speed_hz)

            bench.part.transfer = slow  # type: ignore[method-assign,assignment]
        items += bench.run(seconds)
        bench.part.transfer = transfer  # type: ignore[method-assign]
    counters = bench.sensor.counters
    edges = edges_of(bench.part)
    waiting = bench.sensor._timer.skip()  # came after the last read
    assert counters.edge_reads + counters.missed + counters.missed_starting + counters.unheeded + waiting == edges
    assert counters.samples == counters.edge_reads + counters.paced_reads == len(bursts(items))
    assert counters.bad == len(bursts(items)) - len(good(items))
    assert counters.errors == 0
    assert bench.longest_call_s < 0.3
    assert np.all(np.diff([burst.t_ns for burst in bursts(items)]) >= 0)
    assert np.all(np.diff([burst.t_ns for burst in good(items)]) > 0)
