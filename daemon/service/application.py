"""The daemon: one event loop that joins sensor thread, bus task, estimator, recorder, CAN output and viewers."""

from __future__ import annotations

import asyncio
import json
import logging
import signal
import threading
import time
from collections import deque
from collections.abc import Coroutine
from contextlib import suppress
from dataclasses import asdict
from typing import Any

from daemon.imu.link import ImuLink
from daemon.recording import topics
from daemon.recording.metadata import Preamble, describe, program_version, wall_offset_ns
from daemon.recording.recorder import Recorder
from daemon.recording.topics import Health, Recorded, RecordedDisplacement
from daemon.rows import estimate_row, finite, learned_row, live_row, move_row
from daemon.service import state_file
from daemon.service.health import (
    HealthBook,
    RecorderHealth,
    displacement_condition,
    estimate_condition,
    loop_condition,
    status_line,
)
from daemon.service.live import LiveServer
from daemon.service.log_relay import LogRelay
from daemon.service.loop_watch import Lateness, LoopWatch
from daemon.service.notify import Notifier
from daemon.service.process import settle_process
from daemon.service.watchdog import Watchdog, hanging
from daemon.settings import Settings
from daemon.stream import Stream
from drivers.acquisition import Block
from drivers.can.bus import CanBus
from drivers.can.estimate_frame import EstimateEncoder
from drivers.can.frame import Frame
from drivers.clock import SystemClock
from drivers.condition import OFF
from estimation.records import Displacement, Estimate, Event, Move, Tick

HEALTH_S = 1.0
TICK_S = 0.1
SILENT_IMU_S = 0.25
# The part is reset, tested and configured meanwhile: not silent yet, and what is known of the stroke still holds.
START_UP_S = 10.0
LIVE_ESTIMATE_S = 0.1
MOVES_KEPT, EVENTS_KEPT = 50, 100  # for viewers that come later
STOOD_STILL_S = 0.15  # later than this the loop counts as having stood still
CATCH_UP_S = 1.0
SAVE_STATE_S = 5.0

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
        start = state_file.load(settings.service.state_file, settings)
        self._recorder = Recorder(settings.recording, self._preamble)
        self._stream = Stream(settings, self._receive, start)
        self._live = LiveServer(settings.service.socket, self._hello)
        self._support = None
        if settings.needs_support:
            from daemon.simulation.virtual import virtual_support

            self._support = virtual_support(settings, start_ns=self._clock.now_ns())
        self._imu = ImuLink(settings, self._clock, self._hand_over, self._support)
        self._beside: ImuLink | None = None
        if settings.jy901.use == "beside":
            self._beside = ImuLink(settings, self._clock, self._hand_over, self._support, "beside")
        self._bus: CanBus | None = None
        if settings.can.enabled:
            ids = [frame_id for decoder in self._stream.decoders for frame_id in decoder.arbitration_ids]
            self._bus = CanBus(settings.can, self._take_frame, self._clock, ids)
        self._encoder = EstimateEncoder(settings.can.publish)
        self._blocks: deque[Block] = deque()
        self._frames: deque[Frame] = deque()
        self._ticked_s = time.monotonic()
        self._catch_up_until_s = 0.0
        self._publish_due_ns = 0
        self._live_due_ns = 0
        self._observed: Displacement | None = None  # the newest valid reading
        self._moves: deque[dict[str, Any]] = deque(maxlen=MOVES_KEPT)
        self._events: deque[dict[str, Any]] = deque(maxlen=EVENTS_KEPT)
        self._steps = 0
        self._strokes_learned = self._stream.pipeline.strokes_learned
        self._has_learned = asyncio.Event()
        self._state: state_file.SavedState | None = None  # the newest, to be written
        self._state_lock = threading.Lock()
        self._loop_watch = LoopWatch()
        self._worst_lateness = Lateness()
        self._health_book = HealthBook()
        self._recorder_health = RecorderHealth(self._recorder, settings.recording.enabled)
        self._watchdog = self._make_watchdog()
        self._hanging: set[str] = set()
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
        self._stream.pipeline.prepare(self._settings.nominal_rate_hz)
        await self._live.start()
        self._recorder.start()
        relay = LogRelay(lambda line: self._recorder.write(topics.LOG, line))
        logging.getLogger().addHandler(relay)
        tasks = [self._spawn(work) for work in self._works()]
        self._imu.start()
        if self._beside is not None:
            self._beside.start()
        settle_process()
        self._loop_watch.watch_collector()
        self._notifier.ready()
        _log.info("ramstroke %s runs", program_version())
        try:
            await self._stopping.wait()
        finally:
            self._notifier.stopping()
            self._health_book.is_ending = True
            self._loop_watch.forget_collector()
            await self._shut_down(tasks)
            logging.getLogger().removeHandler(relay)
        if self._failure is not None:
            raise self._failure

    def _works(self) -> list[Coroutine[Any, Any, None]]:
        works = [self._watch_health(), self._tick(), self._save_state()]
        if self._bus is not None:
            works.append(self._bus.run())
        if self._support is not None and self._settings.can.enabled:
            from daemon.simulation.virtual import ControllerTransmitter, virtual_controller

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
        for link in (self._imu, self._beside):
            if link is not None:
                await asyncio.to_thread(link.stop)
        await asyncio.sleep(0)  # blocks handed over until now
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        try:
            self._take_the_rest()
        except Exception as error:
            self._fail(error)  # and still close what is open
        await self._live.close()
        if not await asyncio.to_thread(self._recorder.close):
            _log.error("the disk did not answer: the end of the recording is lost")

    def _take_the_rest(self) -> None:
        """What was received until the end, and what follows from it."""
        self._take_blocks()
        if self._failure is not None:
            return  # the estimator may be what failed
        self._catch_up_until_s = 0.0
        self._take_frames()
        self._stream.finish()
        self._note_state()
        self._write_state()
        self._record_health(self.health())  # the last word of every counter

    # --- inputs -----------------------------------------------------------------------------------------------

    def _hand_over(self, block: Block) -> None:
        """Called in the acquisition threads."""
        assert self._loop is not None
        self._blocks.append(block)
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._take_blocks)

    def _take_blocks(self) -> None:
        """Take what was handed over; before anything else moves the estimator's time past these samples."""
        while self._blocks and self._failure is None:
            block = self._blocks.popleft()
            try:
                with self._loop_watch.doing("inertial samples"):
                    for record in block:
                        self._stream.take(topics.inertial_topic(record), record)
            except Exception as error:
                self._fail(error)

    def _take_frame(self, frame: Frame) -> None:
        self._frames.append(frame)
        self._take_blocks()
        self._take_frames()

    def _take_frames(self) -> None:
        """Take the frames, unless older samples are still on their way: they would come too late for the estimator."""
        if self._is_catching_up():
            return
        with self._loop_watch.doing("CAN frames"):
            while self._frames:
                self._stream.take(topics.CAN_RX, self._frames.popleft())

    def _is_catching_up(self) -> bool:
        """After the loop stood still, for a moment: the acquiring process, if there is one, did not."""
        now_s = time.monotonic()
        if now_s - self._ticked_s > TICK_S + STOOD_STILL_S:
            self._catch_up_until_s = now_s + CATCH_UP_S
        return now_s < self._catch_up_until_s and self._imu.is_behind

    async def _tick(self) -> None:
        """Let time pass in the estimator while the sensor is silent; measure how late the loop is."""
        due_s = time.monotonic()
        started_ns = self._clock.now_ns() + round((START_UP_S - SILENT_IMU_S) * 1e9)
        while True:
            due_s = max(due_s + TICK_S, time.monotonic())  # what was slept through is not made up for
            await asyncio.sleep(due_s - time.monotonic())
            self._loop_watch.woke(due_s)
            self._take_blocks()
            waiting = self._is_catching_up()
            self._ticked_s = time.monotonic()
            if waiting:
                continue
            self._take_frames()
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
            elif self._stream.pipeline.strokes_learned != self._strokes_learned:
                self._strokes_learned = self._stream.pipeline.strokes_learned
                self._has_learned.set()
        elif isinstance(record, Event):
            _log.info("%s", record.what, extra={"fields": {"part": "estimator", "time_ns": record.t_ns}})
            self._events.append({"t_s": record.t_ns * 1e-9, "what": record.what})
            self._live.push("event", self._events[-1])
        elif isinstance(record, Move):
            self._moves.append(finite(move_row(record)))
            self._live.push("move", self._moves[-1])
        elif topic == topics.OBSERVED and isinstance(record, RecordedDisplacement) and record.reading.valid:
            self._observed = record.reading

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
            self._live.push("estimate", live_row(estimate, self._observed))

    def _preamble(self) -> Preamble:
        identity = self._imu.identity
        return Preamble(
            describe(
                "recording",
                self._settings.model_dump_json(),
                sensor="" if identity is None else identity.name,
                wall_minus_monotonic_ns=wall_offset_ns(),
            ),
            self._stream.attachments(),
        )

    def _hello(self) -> dict[str, Any]:
        head = {
            "version": program_version(),
            "stroke_mm": self._settings.support.stroke_mm,
            "moves": list(self._moves),
            "events": list(self._events),
        }
        return head | dict(finite(self.health()))

    # --- health -----------------------------------------------------------------------------------------------

    async def _watch_health(self) -> None:
        """Once a second: a record, a line for viewers and systemd; the watchdog only if nothing stands still."""
        while True:
            await asyncio.sleep(HEALTH_S)
            with self._loop_watch.doing("health"):
                self._worst_lateness = self._loop_watch.take()
                laggards = self._watchdog.laggards(time.monotonic())
                health = self.health() | {"standing_still": {name: round(s, 1) for name, s in laggards.items()}}
                self._tell_laggards(laggards)
                self._record_health(health)
                self._live.push("status", finite(health))
                self._notifier.status(status_line(health, laggards))
                if not laggards:
                    self._notifier.watchdog()

    def _record_health(self, health: dict[str, Any]) -> None:
        self._recorder.write(topics.HEALTH, Health(self._clock.now_ns(), json.dumps(finite(health))))

    def _tell_laggards(self, laggards: dict[str, float]) -> None:
        """Into the log, which outlives what systemd may do; a part that is only slow goes on before that."""
        for name, words in hanging(laggards, self._notifier.watchdog_s).items():
            if name not in self._hanging:
                self._hanging.add(name)
                _log.error("%s", words, extra={"fields": {"part": name}})
        for name in self._hanging - laggards.keys():
            _log.warning("%s goes on", name, extra={"fields": {"part": name}})
        self._hanging &= laggards.keys()

    def _make_watchdog(self) -> Watchdog:
        watchdog = Watchdog()
        watchdog.watch("imu", lambda: self._imu.progress)
        if self._beside is not None:
            beside = self._beside
            watchdog.watch("jy901", lambda: beside.progress)
        if self._bus is not None:
            bus = self._bus
            watchdog.watch("can", lambda: bus.progress)
        watchdog.watch("estimator", lambda: self._steps, expected=lambda: self._stream.last is not None)
        # A disk that hangs is no reason to stop: its queue fills, then losses are counted. A thread that died is one.
        watchdog.watch("recorder", lambda: 0, expected=lambda: self._recorder.has_died)
        return watchdog

    def health(self) -> dict[str, Any]:
        """How every part is now, and what it counted."""
        now_ns = self._clock.now_ns()
        now_s, book, stream = now_ns * 1e-9, self._health_book, self._stream
        last, late = stream.last, self._worst_lateness
        source = stream.decoders[0].report(now_ns) if stream.decoders else None
        sensor = OFF if source is None else displacement_condition(last.can_state if last else None, source.condition)
        health = {
            "t_s": now_s,
            "imu": book.note("imu", self._imu.condition, now_s) | self._imu.counters(),
            "jy901": book.note("jy901", OFF if self._beside is None else self._beside.condition, now_s)
            | ({} if self._beside is None else self._beside.counters()),
            "can": book.note("can", OFF if self._bus is None else self._bus.condition, now_s)
            | ({} if self._bus is None else self._bus.report()),
            "displacement": book.note("displacement", sensor, now_s) | ({} if source is None else source.counters()),
            "estimator": book.note("estimator", estimate_condition(last, self._settings.support.stroke_mm / 1e3), now_s)
            | {
                "samples": stream.samples,
                "bad_samples": stream.bad_bursts,
                "late_samples": stream.pipeline.state.cutter.backward,
                "steps": self._steps,
            },
            "recorder": book.note("recorder", self._recorder_health.condition(now_s), now_s)
            | asdict(self._recorder.counters)
            | {"queued": self._recorder.queued},
            "loop": book.note("loop", loop_condition(late), now_s)
            | {
                "late_ms": round(late.late_s * 1e3, 3),
                "culprit": late.culprit,
                "culprit_ms": round(late.culprit_s * 1e3, 3),
            },
            "live": {"viewers": self._live.viewers, "dropped": self._live.dropped, "refused": self._live.refused},
            "estimate": None if last is None else estimate_row(last),
            "learned": learned_row(stream.learned()),
        }
        return {"state": str(book.worst())} | health

    # --- remembered over a restart ----------------------------------------------------------------------------

    async def _save_state(self) -> None:
        """Every few seconds, and as soon as a move has taught something."""
        while True:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._has_learned.wait(), SAVE_STATE_S)
            self._has_learned.clear()
            self._note_state()
            await asyncio.to_thread(self._write_state)

    def _note_state(self) -> None:
        last = self._stream.last
        if last is not None:
            stroke_mm = self._settings.support.stroke_mm
            self._state = state_file.SavedState.of(last, self._stream.learned(), stroke_mm, time.time())

    def _write_state(self) -> None:
        try:
            with self._state_lock:  # at the end the last periodic writing may still be under way
                if self._state is not None:
                    state_file.save(self._settings.service.state_file, self._state)
        except OSError as error:
            _log.warning("cannot write %s: %s", self._settings.service.state_file, error.strerror)


def _next_due_ns(due_ns: int, period_ns: int, now_ns: int) -> int:
    """Keeps the pace on average although steps come when they come; after a pause it begins anew."""
    return due_ns + period_ns if now_ns - due_ns < period_ns else now_ns + period_ns
