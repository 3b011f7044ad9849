"""The daemon: one event loop that joins sensor thread, bus task, estimator, recorder, CAN output and viewers."""

from __future__ import annotations

import asyncio
import gc
import json
import logging
import signal
import sys
import threading
import time
from collections.abc import Coroutine
from dataclasses import asdict
from typing import Any

from daemon import state_file
from daemon.imu_link import ImuLink
from daemon.live import LiveServer
from daemon.log_relay import LogRelay
from daemon.notify import Notifier
from daemon.recording import topics
from daemon.recording.metadata import LEARNED, SNAPSHOT, Preamble, describe, program_version, wall_offset_ns
from daemon.recording.recorder import Recorder
from daemon.recording.topics import Health, Recorded
from daemon.rows import estimate_row, move_row
from daemon.settings import Settings
from daemon.stream import Stream
from drivers.adis16448.burst import Burst
from drivers.can.bus import CanBus
from drivers.can.estimate_frame import EstimateEncoder
from drivers.can.frame import Frame
from drivers.clock import SystemClock
from estimation.records import Estimate, Event, Move, Segment, Tick

HEALTH_S = 1.0
TICK_S = 0.1
SILENT_IMU_S = 0.25
# The part is reset, tested and configured meanwhile: not silent yet, and what is known of the stroke still holds.
START_UP_S = 10.0
LIVE_ESTIMATE_S = 0.1
SAVE_STATE_S = 5.0
# The reader thread must get the interpreter within half a millisecond: the part has no FIFO.
SWITCH_INTERVAL_S = 0.0005

_log = logging.getLogger(__name__)


class Application:
    """Everything of one run; `await run()` ends on SIGTERM, SIGINT or `stop()`.

    Raises CanConfigError from the constructor and OSError from `run` (the live socket cannot be served).
    """

    def __init__(self, settings: Settings, notifier: Notifier | None = None) -> None:
        self._settings = settings
        self._clock = SystemClock()
        self._notifier = notifier or Notifier()
        self._stopping = asyncio.Event()
        start = state_file.load(settings.service.state_file, settings.support.stroke_mm)
        self._recorder = Recorder(settings.recording, self._preamble)
        self._stream = Stream(settings, self._receive, start)
        self._live = LiveServer(settings.service.socket, self._hello)
        self._support = None
        if settings.imu.transport == "virtual":
            from daemon.virtual import virtual_support

            self._support = virtual_support(settings, start_ns=self._clock.now_ns())
        self._imu = ImuLink(settings, self._clock, self._hand_over, self._support)
        self._bus: CanBus | None = None
        if settings.can.enabled:
            ids = [frame_id for decoder in self._stream.decoders for frame_id in decoder.arbitration_ids]
            self._bus = CanBus(settings.can, self._take_frame, self._clock, ids)
        self._encoder = EstimateEncoder(settings.can.publish)
        self._publish_due_ns = 0
        self._live_due_ns = 0
        self._steps = 0
        self._state_lock = threading.Lock()
        self._loop_late_s = 0.0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._failure: BaseException | None = None

    def stop(self) -> None:
        """End the run; safe from signal handlers."""
        self._stopping.set()

    async def run(self) -> None:
        """Run until stopped."""
        self._loop = loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.stop)
        self._stream.pipeline.prepare()
        await self._live.start()
        self._recorder.start()
        relay = LogRelay(lambda line: self._recorder.write(topics.LOG, line))
        logging.getLogger().addHandler(relay)
        tasks = [self._spawn(work) for work in self._works()]
        self._imu.start()
        _settle_process()
        self._notifier.ready()
        _log.info("ramstroke %s runs", program_version())
        try:
            await self._stopping.wait()
        finally:
            self._notifier.stopping()
            await self._shut_down(tasks)
            logging.getLogger().removeHandler(relay)
        if self._failure is not None:
            raise self._failure

    def _works(self) -> list[Coroutine[Any, Any, None]]:
        works = [self._watch_health(), self._tick(), self._save_state()]
        if self._bus is not None:
            works.append(self._bus.run())
        if self._support is not None and self._settings.can.enabled:
            from daemon.virtual import ControllerTransmitter, virtual_controller

            controller = virtual_controller(self._settings, self._support)
            works.append(ControllerTransmitter(self._settings, controller, self._clock).run())
        return works

    def _spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """A task whose failure, a fault of the program, ends the run instead of going unseen."""
        task = asyncio.ensure_future(work)

        def ended(task: asyncio.Task[None]) -> None:
            if not task.cancelled() and (error := task.exception()) is not None:
                self._fail(error)

        task.add_done_callback(ended)
        return task

    def _fail(self, error: BaseException) -> None:
        """End the run with `error`; the first one counts."""
        self._failure = self._failure or error
        self.stop()

    async def _shut_down(self, tasks: list[asyncio.Task[None]]) -> None:
        await asyncio.to_thread(self._imu.stop)
        await asyncio.sleep(0)  # blocks handed over until now
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if self._failure is None:  # else the estimator may be what failed
            self._stream.finish()
            self._write_state()
        await self._live.close()
        if not await asyncio.to_thread(self._recorder.close):
            _log.error("the disk did not answer: the end of the recording is lost")

    # --- inputs -----------------------------------------------------------------------------------------------

    def _hand_over(self, block: list[Burst]) -> None:
        """Called in the acquisition thread."""
        assert self._loop is not None
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._take_block, block)

    def _take_block(self, block: list[Burst]) -> None:
        if self._failure is not None:
            return
        try:
            for burst in block:
                self._stream.take(topics.IMU_RAW, burst)
        except Exception as error:
            self._fail(error)

    def _take_frame(self, frame: Frame) -> None:
        self._stream.take(topics.CAN_RX, frame)

    async def _tick(self) -> None:
        """Let time pass in the estimator while the sensor is silent; measure how late the loop is."""
        due_s = time.monotonic()
        started_ns = self._clock.now_ns() + round((START_UP_S - SILENT_IMU_S) * 1e9)
        while True:
            due_s += TICK_S
            await asyncio.sleep(max(due_s - time.monotonic(), 0.0))
            self._loop_late_s = max(self._loop_late_s, time.monotonic() - due_s)
            due_s = max(due_s, time.monotonic() - 1.0)
            now_ns = self._clock.now_ns()
            last_ns = self._stream.last_sample_ns or started_ns
            if now_ns - last_ns > SILENT_IMU_S * 1e9:
                self._stream.take(topics.TICK, Tick(now_ns))

    # --- outputs ----------------------------------------------------------------------------------------------

    def _receive(self, topic: str, record: Recorded) -> None:
        """Sink of the stream: everything goes to the recorder, some of it further."""
        self._recorder.write(topic, record)
        if isinstance(record, Estimate):
            if topic == topics.PROVISIONAL:
                self._steps += 1
                self._publish(record)
        elif isinstance(record, Event):
            _log.info("%s", record.what)
            self._live.push("event", {"t_s": record.t_ns * 1e-9, "what": record.what})
        elif isinstance(record, Move):
            self._live.push("move", move_row(record))

    def _publish(self, estimate: Estimate) -> None:
        t_ns = estimate.t_ns
        settings = self._settings.can.publish
        if self._bus is not None and settings.enabled and t_ns >= self._publish_due_ns:
            self._publish_due_ns = _next_due_ns(self._publish_due_ns, round(settings.period_ms * 1e6), t_ns)
            frame = self._encoder.encode(estimate)
            if self._bus.send(frame):
                self._recorder.write(topics.CAN_TX, frame)
        if t_ns >= self._live_due_ns:
            self._live_due_ns = _next_due_ns(self._live_due_ns, round(LIVE_ESTIMATE_S * 1e9), t_ns)
            self._live.push("estimate", estimate_row(estimate))

    def _preamble(self) -> Preamble:
        identity = self._imu.identity
        sensor = "" if identity is None else f"ADIS16448 lot {identity.lot_id:08X} serial {identity.serial}"
        return Preamble(
            describe(
                "recording",
                self._settings.model_dump_json(),
                sensor=sensor,
                wall_minus_monotonic_ns=wall_offset_ns(),
            ),
            {SNAPSHOT: self._stream.snapshot(), LEARNED: b"{}"},
        )

    def _hello(self) -> dict[str, Any]:
        return {"version": program_version(), "stroke_mm": self._settings.support.stroke_mm} | self._health()

    # --- health -----------------------------------------------------------------------------------------------

    async def _watch_health(self) -> None:
        """Once a second: a record, a line for viewers and systemd; the watchdog only if something has moved."""
        moved_before = self._moved()
        while True:
            await asyncio.sleep(HEALTH_S)
            health = self._health()
            now_ns = self._clock.now_ns()
            self._recorder.write(topics.HEALTH, Health(now_ns, json.dumps(health)))
            self._live.push("status", health)
            self._notifier.status(_status_line(health))
            moved = self._moved()
            # Estimates alone prove nothing: they go on, blind, when all sensors hang.
            if moved[0] != moved_before[0] and moved[1] != moved_before[1]:
                self._notifier.watchdog()
            moved_before = moved
            self._loop_late_s = 0.0

    def _moved(self) -> tuple[int, int]:
        """What came in so far, attempts to reach a missing device included, and the estimates made meanwhile.

        A support that is switched off must not get its daemon killed for ever.
        """
        came = self._stream.samples + self._imu.attempts
        if self._bus is not None:
            came += self._bus.counters.received + self._bus.counters.failures
        return came, self._steps

    def _health(self) -> dict[str, Any]:
        health: dict[str, Any] = {
            "t_s": self._clock.now_ns() * 1e-9,
            "imu": self._imu.health() | {"bad_bursts": self._stream.bad_bursts},
            "can": {"state": "disabled"},
            "recorder": _recorder_health(self._recorder, self._settings.recording.enabled),
            "live": {
                "viewers": self._live.viewers,
                "dropped": self._live.dropped,
                "refused": self._live.refused,
            },
            "loop_late_ms": round(self._loop_late_s * 1e3, 3),
        }
        if self._bus is not None:
            decoders = [
                {"malformed": d.malformed, "out_of_range": d.out_of_range, "invalid": d.invalid}
                for d in self._stream.decoders
            ]
            health["can"] = asdict(self._bus.counters) | {
                "state": self._bus.state,
                "controller": self._bus.controller_state,
                "last_error": self._bus.last_error,
                "sources": decoders,
            }
        last = self._stream.last
        health["estimate"] = None if last is None else estimate_row(last)
        return health

    # --- remembered stroke ------------------------------------------------------------------------------------

    async def _save_state(self) -> None:
        while True:
            await asyncio.sleep(SAVE_STATE_S)
            await asyncio.to_thread(self._write_state)

    def _write_state(self) -> None:
        last = self._stream.last
        if last is None:
            return
        saved = state_file.SavedStroke(
            wall_time_s=time.time(),
            stroke_mm=self._settings.support.stroke_mm,
            displacement_mm=last.displacement_m * 1e3,
            sigma_mm=last.sigma_m * 1e3,
            at_rest=last.segment is Segment.ZUPT,
        )
        try:
            with self._state_lock:  # at the end the last periodic writing may still be under way
                state_file.save(self._settings.service.state_file, saved)
        except OSError as error:
            _log.warning("cannot write %s: %s", self._settings.service.state_file, error.strerror)


def _settle_process() -> None:
    """Collect once, then spare the collector what will live for ever: a full pass costs dozens of samples."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 50, 1000)
    sys.setswitchinterval(SWITCH_INTERVAL_S)


def _next_due_ns(due_ns: int, period_ns: int, now_ns: int) -> int:
    """Keeps the pace on average although steps come when they come; after a pause it begins anew."""
    return due_ns + period_ns if now_ns - due_ns < period_ns else now_ns + period_ns


def _recorder_health(recorder: Recorder, enabled: bool) -> dict[str, Any]:
    if not enabled:
        return {"state": "disabled"}
    counters = asdict(recorder.counters)
    state = "recording" if counters.get("file") else f"waiting: {counters.get('last_error') or 'no file yet'}"
    return counters | {"state": state, "queued": recorder.queued}


def _status_line(health: dict[str, Any]) -> str:
    estimate = health["estimate"]
    stroke = (
        "no estimate yet"
        if estimate is None
        else f"{estimate['displacement_mm']:.1f} ± {estimate['sigma_mm']:.1f} mm, {estimate['segment']}"
    )
    parts = [f"{name} {health[name]['state']}" for name in ("imu", "can", "recorder")]
    return f"{stroke}; {'; '.join(parts)}"
