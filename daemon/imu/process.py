"""Acquisition in a process of its own, as the daemon sees it."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from daemon.imu.messages import Health, LogLine, Orders, receive, send
from daemon.imu.ports import no_counters
from daemon.settings import Settings
from drivers.acquisition import AnyIdentity, Block
from drivers.condition import Condition, Wellness

FIRST_RETRY_S, LONGEST_RETRY_S = 0.5, 5.0
HANG_S = 5.0  # a living child sends its health four times a second
START_S = 30.0  # a child that makes a virtual support on a slow computer
_SLICE_S = 0.5
BEHIND_S = 0.15  # blocks are handed over within 0.1 s
SILENCE_S = 0.4  # health comes more often
_STOP_S = 2.0

_log = logging.getLogger(__name__)


class ImuProcess:
    """Keeps an acquiring process alive and receives what it sends, in a thread; see `ImuLink` for the rest."""

    def __init__(self, settings: Settings, start_ns: int, on_block: Callable[[Block], None]) -> None:
        self.condition = Condition(Wellness.WAITING, "not started yet")
        self.identity: AnyIdentity | None = None
        self.notes: list[str] = []
        self.progress = 0
        self._heard_s = 0.0  # when the process last sent anything
        self._lag_s = 0.0  # how old the last samples were when they came
        self.pid: int | None = None  # of the process that acquires now
        self._orders = Orders(settings.model_dump_json(), start_ns)
        self._on_block = on_block
        # Of the processes that ended and of the present one; replaced as a pair, so that none counts twice.
        self._none = no_counters(settings, "main")
        self._counters: tuple[Any, Any] = (self._none, self._none)
        self._dropped = (0, 0)
        self._starts = 0
        self._lost_blocks = 0
        self._stopping = threading.Event()
        self._child: subprocess.Popen[bytes] | None = None
        self._child_lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="acquisition process", daemon=True)

    def start(self) -> None:
        """Start thread and process."""
        self._thread.start()

    def stop(self) -> None:
        """End both; what the process still holds is received first."""
        self._stopping.set()
        if not self._thread.is_alive():
            return
        self._dismiss()
        self._thread.join(_STOP_S)
        if self._thread.is_alive() and (pid := self.pid) is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            self._thread.join(_STOP_S)

    @property
    def counters(self) -> Any:
        """Of the sensor, over all processes so far."""
        past, present = self._counters
        return past.plus(present)

    @property
    def is_behind(self) -> bool:
        """Whether samples may still be in the pipe: this process stood still, the other one did not."""
        if self.pid is None:
            return False
        return self._lag_s > BEHIND_S or time.monotonic() - self._heard_s > SILENCE_S

    def own_counters(self) -> dict[str, int]:
        """Of this side."""
        return {
            "process_restarts": max(0, self._starts - 1),
            "dropped": sum(self._dropped),
            "lost_blocks": self._lost_blocks,
        }

    def _run(self) -> None:
        retry_s = FIRST_RETRY_S
        while not self._stopping.is_set():
            try:
                samples = self.counters.samples
                why = self._live_once()
                if self.counters.samples > samples:
                    retry_s = FIRST_RETRY_S
            except OSError as error:
                why = f"cannot be started: {error}"
            except Exception as error:
                why = f"met a fault of the program ({type(error).__name__}: {error})"
                if not self._stopping.is_set():
                    _log.exception("inertial sensor: a fault of the program, which goes on")
            if self._stopping.is_set():
                break
            self.condition = Condition(
                Wellness.WAITING,
                f"the acquisition process {why}; it is started again",
                'look for its last words in the log; if that goes on, set acquisition = "thread" in [imu]',
            )
            _log.warning("inertial sensor: %s", self.condition.what)
            self._pause(retry_s)
            retry_s = min(2 * retry_s, LONGEST_RETRY_S)

    def _pause(self, seconds: float) -> None:
        """Wait, and show meanwhile that this thread lives."""
        for _ in range(round(seconds / _SLICE_S)):
            self.progress += 1
            if self._stopping.wait(_SLICE_S):
                break

    def _live_once(self) -> str:
        """Start a process and listen to it to its end; returns what ended it."""
        self._starts += 1
        self.progress += 1
        self.condition = Condition(Wellness.WAITING, "the acquisition process is being started")
        child = subprocess.Popen(
            [sys.executable, "-m", "daemon.imu.child"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        with self._child_lock:
            self._child, self.pid = child, child.pid
        assert child.stdin is not None
        assert child.stdout is not None
        why = "ended"
        try:
            send(child.stdin.fileno(), self._orders)
            if self._stopping.is_set():  # `stop` came too early to see this process
                self._dismiss()
            self._listen(child.stdout.fileno())
        except TimeoutError:
            why = "hung"
        except BrokenPipeError:
            pass  # it ended before it heard its orders
        finally:
            self._dismiss()
            child.kill()
            code = child.wait()
            self.pid = None
            child.stdout.close()
            self._counters = (self.counters, self._none)
            self._dropped = (sum(self._dropped), 0)
        return why if why == "hung" else f"ended ({_ending(code)})"

    def _dismiss(self) -> None:
        """The end of its orders is the end of the process."""
        with self._child_lock:
            child, self._child = self._child, None
        if child is not None and child.stdin is not None:
            child.stdin.close()

    def _listen(self, fd: int) -> None:
        """Receive to the end. Raises TimeoutError if the process hangs."""
        patience_s, progress = START_S, 0
        while (message := receive(fd, patience_s)) is not None:
            patience_s = HANG_S
            self._heard_s = time.monotonic()
            if isinstance(message, Health):
                self.condition, self.identity, self.notes = message.condition, message.identity, message.notes
                self._counters = (self._counters[0], message.counters)
                self._dropped = (self._dropped[0], message.dropped)
                self.progress += message.progress - progress
                progress = message.progress
            elif isinstance(message, LogLine):
                logging.getLogger(message.logger).log(message.level, "%s", message.text)
            elif isinstance(message, list):
                self._hand_over(message)

    def _hand_over(self, block: Block) -> None:
        self._lag_s = time.monotonic() - block[-1].t_ns * 1e-9
        try:
            self._on_block(block)
        except Exception:
            self._lost_blocks += 1
            if self._lost_blocks == 1:
                _log.exception("a block of inertial samples is lost: nobody could take it")


def _ending(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"
