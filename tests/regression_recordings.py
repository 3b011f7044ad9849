"""Makes the recordings of the virtual support in tests/data/regression.

python -m tests.regression_recordings && make rebase
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from drivers.virtual.faults import FaultScript
from drivers.virtual.motion import PlannedMove
from tests.acceptance.fault_scene import play

FOLDER = Path(__file__).parent / "data" / "regression"
WHOLE = (PlannedMove(6.0, 0.12, 0.01453), PlannedMove(4.0, 0.0, 0.03519))
IN_PARTS = (PlannedMove(6.0, 0.07, 0.01453), PlannedMove(4.0, 0.12, 0.01453), PlannedMove(4.0, 0.03, 0.03519))

SCENES: dict[str, tuple[tuple[PlannedMove, ...], list[dict[str, Any]]]] = {
    "controller_falls_silent_in_a_push": (WHOLE, [{"kind": "can_silence", "at_s": 8.5, "for_s": 1000.0}]),
    "partial_push_and_retract": (IN_PARTS, []),
    "wet_cable_in_a_push": (
        WHOLE,
        [
            {"kind": "bit_flips", "at_s": 3.0, "for_s": 1.0},
            {"kind": "miso_low", "at_s": 8.0, "for_s": 0.5},
            {"kind": "data_ready_lost", "at_s": 10.0, "for_s": 2.0},
            {"kind": "brown_out", "at_s": 13.0, "for_s": 0.1},
            {"kind": "spi_error", "at_s": 16.0, "for_s": 0.3},
            {"kind": "repeated_samples", "at_s": 20.0, "for_s": 0.5},
        ],
    ),
    "another_sensor_and_a_sick_bus": (
        WHOLE,
        [
            {"kind": "replaced", "at_s": 1.5, "for_s": 0.5},
            {"kind": "error_frames", "at_s": 5.0, "for_s": 1.0, "rate_hz": 20.0},
            {"kind": "corrupted", "at_s": 8.0, "for_s": 1.0},
            {"kind": "frozen_frame", "at_s": 9.5, "for_s": 1.0},
            {"kind": "bus_off", "at_s": 11.0, "for_s": 1.5},
            {"kind": "sensor_error", "at_s": 17.0, "for_s": 1.0},
            {"kind": "wrong_length", "at_s": 20.0, "for_s": 1.0},
        ],
    ),
}


def main() -> None:
    """Write them all."""
    for name, (moves, faults) in SCENES.items():
        path = FOLDER / f"{name}.mcap"
        path.unlink(missing_ok=True)
        script = FaultScript.model_validate({"fault": faults})
        # A quarter of the samples per second keeps the files small.
        play(script, script=moves, seed=5, recording=path, channel=name, decimation_exponent=2)
        print(path.name, path.stat().st_size)


if __name__ == "__main__":
    main()
