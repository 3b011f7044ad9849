"""A daemon that says exactly what a test wants said, on a Unix socket."""

from __future__ import annotations

import json
import socket
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

PARTS = ("imu", "jy901", "can", "displacement", "estimator", "recorder", "loop")


def estimate(mm: float = 347.2, sigma: float = 0.6, speed: float = 14.5, **more: object) -> dict[str, Any]:
    row = {"t_s": time.monotonic(), "displacement_mm": mm, "sigma_mm": sigma, "velocity_mm_s": speed}
    return row | {"segment": "CVS", "can_state": "ok", "move": 3} | more


def status(row: dict[str, Any] | None = None, **parts: dict[str, Any]) -> dict[str, Any]:
    now_s = time.monotonic()
    well = {"state": "ok", "since_s": now_s, "what": "", "advice": ""}
    told: dict[str, Any] = {name: well | parts.get(name, {}) for name in PARTS}
    told["jy901"] = well | {"state": "off"} | parts.get("jy901", {})
    live = {"viewers": 1, "dropped": 0, "refused": 0}
    return {"state": "ok", "t_s": now_s} | told | {"live": live, "estimate": row or estimate(), "learned": None}


def hello(row: dict[str, Any] | None = None, **parts: dict[str, Any]) -> dict[str, Any]:
    greeting = {"type": "hello", "version": "9.8.7", "stroke_mm": 500.0, "moves": [], "events": []}
    return greeting | status(row, **parts)


def encoded(content: dict[str, Any]) -> bytes:
    return json.dumps(content, separators=(",", ":")).encode() + b"\n"


class FakeDaemon:
    """A context manager; greets every viewer, then sends what it is told to all of them."""

    def __init__(self, path: Path, greeting: bytes | None = None) -> None:
        self._path = path
        self.greeting = encoded(hello()) if greeting is None else greeting
        self._viewers: list[socket.socket] = []
        self._lock = threading.Lock()
        self.welcomed = 0

    def __enter__(self) -> Self:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.bind(str(self._path))
        self._socket.listen()
        self._thread = threading.Thread(target=self._welcome, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._path.unlink()
        self._thread.join()
        for viewer in self._viewers:
            viewer.close()

    def _welcome(self) -> None:
        while True:
            try:
                viewer, _ = self._socket.accept()
            except OSError:
                return
            with self._lock:
                viewer.sendall(self.greeting)
                self._viewers.append(viewer)
                self.welcomed += 1

    def send(self, kind: str, content: dict[str, Any]) -> None:
        self.send_bytes(encoded({"type": kind} | content))

    def send_bytes(self, data: bytes) -> None:
        with self._lock:
            for viewer in list(self._viewers):
                try:
                    viewer.sendall(data)
                except OSError:
                    self._viewers.remove(viewer)

    def hang_up(self) -> None:
        with self._lock:
            for viewer in self._viewers:
                viewer.close()
            self._viewers.clear()
