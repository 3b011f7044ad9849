"""The live view at a terminal: reads the daemon, draws four times a second, listens to the keys."""

from __future__ import annotations

import asyncio
import copy
import os
import re
import signal
import time
from contextlib import suppress

from daemon.service.live_client import LiveLink
from daemon.watch.glyphs import Glyphs
from daemon.watch.layout import Look, compose
from daemon.watch.scene import Scene
from daemon.watch.screen import Screen
from daemon.watch.words import Words

DRAW_S = 0.25
QUIT_KEYS, PAUSE_KEYS = b"qQ\x03\x04", b"pP "
OTHER_KEYS = re.compile(rb"\x1b(\[[0-?]*[ -/]*[@-~]|O.|.)?")  # arrows, function keys, Alt with another


class View:
    """One run of it."""

    def __init__(self, link: LiveLink, screen: Screen, keyboard: int | None, words: Words, glyphs: Glyphs) -> None:
        self._link = link
        self._screen = screen
        self._keyboard = keyboard
        self._words = words
        self._glyphs = glyphs
        self._scene = Scene()
        self._frozen: Scene | None = None
        self._paused_at: float | None = None
        self._ending = asyncio.Event()
        self._redraw = asyncio.Event()

    async def run(self) -> None:
        """Until `q`, Ctrl-C or SIGTERM. Raises ForbiddenError if this user may not read the daemon at all."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            loop.add_signal_handler(number, self._ending.set)
        loop.add_signal_handler(signal.SIGWINCH, self._redraw.set)
        loop.add_signal_handler(signal.SIGTSTP, self._sleep)
        reading = asyncio.ensure_future(self._read())
        ending = asyncio.ensure_future(self._ending.wait())
        with self._screen:
            if self._keyboard is not None:
                loop.add_reader(self._keyboard, self._take_keys)
            drawing = asyncio.ensure_future(self._draw())
            tasks = [reading, ending, drawing]
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if self._keyboard is not None:
                loop.remove_reader(self._keyboard)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        for task in done:
            task.result()

    async def _read(self) -> None:
        async for told in self._link.follow():
            was = self._scene.link()
            self._scene.take(told)
            if self._scene.link() != was:
                self._redraw.set()

    async def _draw(self) -> None:
        with suppress(OSError):  # the terminal has gone
            while True:
                self._redraw.clear()
                width, height = self._screen.size()
                look = Look(width, height, self._words, self._glyphs)
                shown = self._scene if self._frozen is None else self._frozen
                lines = compose(shown, self._scene, self._paused_at, self._link.damaged, look)
                self._screen.draw(lines, (width, height))
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._redraw.wait(), DRAW_S)

    def _take_keys(self) -> None:
        assert self._keyboard is not None
        try:
            keys = os.read(self._keyboard, 1024)
        except OSError:
            keys = b""
        if not keys:
            self._ending.set()
        for key in OTHER_KEYS.sub(b"", keys):
            if key in QUIT_KEYS:
                self._ending.set()
            elif key in PAUSE_KEYS:
                self._pause()

    def _pause(self) -> None:
        if self._frozen is None:
            self._frozen, self._paused_at = copy.deepcopy(self._scene), time.time()
        else:
            self._frozen = self._paused_at = None
        self._redraw.set()

    def _sleep(self) -> None:
        """Ctrl-Z: give the terminal back, and take it again when the shell goes on with this program."""
        self._screen.leave()
        os.kill(os.getpid(), signal.SIGSTOP)
        self._screen.enter()
        self._redraw.set()
