"""The live view for pipes and files: a line a second, and one for everything that happens."""

from __future__ import annotations

import asyncio
import signal
import sys
import time
from collections.abc import Callable, Iterator
from datetime import datetime

from daemon.service.live_client import Gone, Line, LiveLink, Silent
from daemon.watch.figures import figure
from daemon.watch.glyphs import Glyphs, in_ascii
from daemon.watch.scene import Scene
from daemon.watch.words import Words


async def tell(link: LiveLink, words: Words, glyphs: Glyphs) -> None:
    """Print until interrupted. Raises ForbiddenError, and BrokenPipeError when the reader has gone."""
    scene = Scene()
    parts: dict[str, tuple[str, str]] = {}

    def say(text: str) -> None:
        line = f"{datetime.now():%H:%M:%S}  {text}"
        print(in_ascii(line) if glyphs.is_ascii else line, flush=True)

    def take(told: Line | Silent | Gone) -> None:
        if isinstance(told, Silent):
            say(words("silent_for", f"{time.monotonic() - told.since_s:.0f}"))
            return
        scene.take(told)
        for text in _sentences(told, scene, parts, words):
            say(text)

    await _follow(link, take)


async def pass_on(link: LiveLink) -> None:
    """The daemon's lines as they are on standard output, other words on standard error. Raises as `tell`."""

    def take(told: Line | Silent | Gone) -> None:
        if isinstance(told, Line):
            sys.stdout.buffer.write(told.raw)
            sys.stdout.buffer.flush()
        else:
            why = told.why if isinstance(told, Gone) else "connected, but silent"
            print(f"ramstroke: {why}", file=sys.stderr, flush=True)

    await _follow(link, take)


async def _follow(link: LiveLink, take: Callable[[Line | Silent | Gone], None]) -> None:
    """`take` everything; ends on SIGINT and SIGTERM."""

    async def read() -> None:
        async for told in link.follow():
            take(told)

    reading = asyncio.ensure_future(read())
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, reading.cancel)
    try:
        await reading
    except asyncio.CancelledError:
        return


def _sentences(told: Line | Gone, scene: Scene, parts: dict[str, tuple[str, str]], words: Words) -> Iterator[str]:
    if isinstance(told, Gone):
        yield told.why
        return
    if told.kind in ("hello", "status"):
        yield _stroke(scene, words)
        for part in scene.parts:
            was = parts.get(part.name)
            parts[part.name] = part.state, part.advice
            if (part.what and was != parts[part.name]) or (was and not part.what and was[0] != part.state):
                because = f": {part.what}; {part.advice}" if part.what else ""
                yield f"{words(part.name)} {words(f'part_{part.state}')}{because}"
    elif told.kind == "event" and scene.events:
        yield f"{words('events')}: {scene.events[-1].what}"
    elif told.kind == "move" and scene.moves:
        move = scene.moves[-1]
        yield (
            f"{words('move')}: {words(move.kind)} {figure(move.start_mm, '.1f')} → {figure(move.end_mm, '.1f')} "
            f"± {figure(move.sigma_mm, '.1f')} mm, {figure(move.velocity_mm_s, '+.2f')} mm/s, "
            f"{words('sensor_short')} {words.sensor(move.can_state)}"
        )
    elif told.kind == "dropped":
        yield words("lost", scene.lost)


def _stroke(scene: Scene, words: Words) -> str:
    stroke = scene.stroke
    if stroke is None:
        return words("no_estimate")
    if scene.is_undetermined:
        sigma = f"± {stroke.sigma_mm:.0f} {words('sigma')}"
        return f"{words('undetermined')} ({sigma}), {words('sensor_short')} {words.sensor(stroke.can_state)}"
    return (
        f"{stroke.displacement_mm:.1f} ± {stroke.sigma_mm:.1f} {words('sigma')}  {stroke.velocity_mm_s:+.1f} mm/s  "
        f"{words(stroke.segment)}  {words('sensor_short')} {words.sensor(stroke.can_state)}"
    )
