"""The daemon in this process, and a viewer of it."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from daemon.service.application import Application
from daemon.settings import Settings

PATIENCE_S = 60.0  # for a machine that is busy with other things


def settings_in(folder: Path, **sections: dict[str, Any]) -> Settings:
    """A daemon on twins, with everything it writes in `folder`."""
    tree: dict[str, dict[str, Any]] = {
        "imu": {"transport": "virtual"},
        "can": {
            "interface": "virtual",
            "channel": str(folder),
            "listen_only": False,
            "reference": {"message": "LaboratorySensor", "signal": "reference_stroke"},
            "publish": {"enabled": True},
        },
        "recording": {"directory": str(folder / "recordings"), "keep_free_mb": 0},
        "service": {"socket": str(folder / "live"), "state_file": str(folder / "state.json")},
    }
    for name, values in sections.items():
        tree.setdefault(name, {}).update(values)
    return Settings.model_validate(tree)


def run(running: Application, scene: Callable[[], Awaitable[None]]) -> None:
    """Play `scene` beside the running application, then stop it."""

    async def both() -> None:
        task = asyncio.ensure_future(running.run())
        playing = asyncio.ensure_future(scene())
        try:
            await asyncio.wait({task, playing}, timeout=PATIENCE_S, return_when=asyncio.FIRST_COMPLETED)
            if playing.done():
                playing.result()
            else:
                playing.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await playing
                assert task.done(), "the scene takes too long"
        finally:
            running.stop()
            await asyncio.wait_for(task, PATIENCE_S)

    asyncio.run(both())


async def forever() -> None:
    await asyncio.Event().wait()


class Viewer:
    """Reads the live socket of `settings`, from the moment it is there."""

    def __init__(self, settings: Settings) -> None:
        self._path = settings.service.socket
        self.lines: list[dict[str, Any]] = []

    async def read_until(self, enough: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        if not self.lines:
            while not self._path.exists():
                await asyncio.sleep(0.01)
            self._reader, self._writer = await asyncio.open_unix_connection(self._path)
        while True:
            line = json.loads(await self._reader.readline())
            self.lines.append(line)
            if enough(line):
                return dict(line)

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [line for line in self.lines if line["type"] == kind]
