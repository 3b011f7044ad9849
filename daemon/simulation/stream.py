"""A simulated run joined to the estimator as the daemon joins a live one, ticks of a silent sensor included."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

from daemon.recording import topics
from daemon.service.application import SILENT_IMU_S, START_UP_S, TICK_S
from daemon.settings import Settings
from daemon.simulation.run import SimulatedRun
from daemon.stream import Sink, Stream
from drivers.clock import Clock
from estimation.pipeline import Start
from estimation.records import Tick


class SimulatedStream:
    """Twins, driver, bus and estimator in simulated time.

    Args:
        settings: of the program.
        run: the devices; closed together with this.
        clock: of the run.
        sink: receives everything that the stream takes in and gives out.
        start: what is known of the stroke at the beginning.
    """

    def __init__(
        self,
        settings: Settings,
        run: SimulatedRun,
        clock: Clock,
        sink: Sink,
        start: Start | None = None,
    ) -> None:
        self._clock = clock
        self.run = run
        self.stream = Stream(settings, sink, start or Start(0.0))
        self._tick_due_ns = clock.now_ns()
        self._silent_from_ns = clock.now_ns() + round((START_UP_S - SILENT_IMU_S) * 1e9)

    def step(self) -> bool:
        """Take in what came next, or let time pass if nothing did; False at the end of the motion."""
        received = self.run.next()
        if received is None:
            return False
        block, frames = received
        for record in block:
            self.stream.take(topics.inertial_topic(record), record)
        for frame in frames:
            self.stream.take(topics.CAN_RX, frame)
        self._tick()
        return True

    def play(self, progress: Callable[[int], None]) -> None:
        """Go to the end of the motion and settle what is left; `progress` hears the time [ns]."""
        while self.step():
            progress(self._clock.now_ns())
        self.stream.finish()

    def _tick(self) -> None:
        """Let time pass in the estimator while the inertial sensor is silent."""
        now_ns = self._clock.now_ns()
        if now_ns < self._tick_due_ns:
            return
        self._tick_due_ns = now_ns + round(TICK_S * 1e9)
        last_ns = self.stream.last_sample_ns or self._silent_from_ns
        if now_ns - last_ns > SILENT_IMU_S * 1e9:
            self.stream.take(topics.TICK, Tick(now_ns))

    def close(self) -> None:
        """Release the buses."""
        self.run.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
