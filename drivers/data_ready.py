"""The data-ready line of the sensor: when there is a new sample."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Protocol

from estimation.records import TimeKind

# Deeper than any stall worth surviving needs: only the newest edge counts, the depth merely keeps the
# kernel's own overflow rare.
_EVENT_BUFFER = 64


class DataReadyError(OSError):
    """The data-ready line cannot be opened or read; the text is one sentence for a person."""


@dataclass(slots=True, frozen=True)
class Edge:
    """The sample now in the sensor's registers: when it became valid, and what was lost before it."""

    t_ns: int
    kind: TimeKind
    missed: int = 0


class DataReady(Protocol):
    """Tells when a new sample may be read."""

    def wait(self, timeout_s: float) -> Edge | None:
        """The newest edge, else the next one; None if the line stays silent that long. Raises DataReadyError."""

    def close(self) -> None:
        """Release the line."""


class GpiodDataReady:
    """A GPIO line whose edges the kernel stamps with CLOCK_MONOTONIC (character device v2, gpiod 2.x)."""

    def __init__(self, chip_path: str, line_offset: int, *, active_high: bool = True) -> None:
        try:
            import gpiod
            from gpiod.line import Clock as EventClock
            from gpiod.line import Direction
            from gpiod.line import Edge as LineEdge
        except ImportError:
            raise DataReadyError(
                f"cannot use {chip_path}: the Python module gpiod is missing, install ramstroke[hardware]"
            ) from None
        self._name = f"line {line_offset} of {chip_path}"
        line = gpiod.LineSettings(
            direction=Direction.INPUT,
            edge_detection=LineEdge.RISING if active_high else LineEdge.FALLING,
            event_clock=EventClock.MONOTONIC,
        )
        try:
            self._request: Any = gpiod.request_lines(
                chip_path, consumer="ramstroke", config={line_offset: line}, event_buffer_size=_EVENT_BUFFER
            )
        except ValueError:
            raise DataReadyError(
                f"{chip_path} has no line {line_offset}; set data_ready_chip and data_ready_line"
            ) from None
        except OSError as error:
            raise DataReadyError(
                f"cannot watch {self._name} for data-ready: {error}; set data_ready_chip and data_ready_line"
            ) from error
        # The kernel numbers the edges of a request from 1 on (gpio_v2_line_event.line_seqno).
        self._last_number = 0

    def wait(self, timeout_s: float) -> Edge | None:
        """Wait for an edge and return the newest one.

        The part has no memory of older samples, so only the newest edge belongs to the registers. The
        kernel numbers the edges, also those its full buffer dropped: one difference counts every loss.
        """
        try:
            if not self._request.wait_edge_events(timeout_s):
                return None
            newest = self._request.read_edge_events()[-1]
        except OSError as error:
            raise DataReadyError(f"cannot read {self._name}: {error}") from error
        missed = (newest.line_seqno - self._last_number - 1) & 0xFFFF_FFFF  # the number has 32 bits: 60 days
        self._last_number = newest.line_seqno
        return Edge(newest.timestamp_ns, TimeKind.EDGE, missed)

    def close(self) -> None:
        """Give the line back."""
        self._request.release()


# Words in the names of lines that belong to another block of the chip although the kernel calls them unused.
_TAKEN = re.compile(r"SPI|MOSI|MISO|SCL|SDA|TXD|RXD|UART|I2C|CTS|RTS|SD\d?_|PWM|PCM|STATUS|RGMII|ETH|HDMI|CAM", re.I)


def free_inputs(chip_path: str) -> list[int]:
    """Lines of a chip that are inputs, that nobody uses, and whose names speak of nothing else."""
    try:
        import gpiod
        from gpiod.line import Direction

        with gpiod.Chip(chip_path) as chip:
            lines = [chip.get_line_info(offset) for offset in range(chip.get_info().num_lines)]
    except (ImportError, OSError):
        return []
    return [
        line.offset
        for line in lines
        if not line.used and line.direction == Direction.INPUT and not _TAKEN.search(line.name or "")
    ]
