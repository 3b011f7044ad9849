"""The data-ready line: does it follow the part's pin, and if not, which line does?"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

from daemon.doctor import node
from daemon.doctor.report import Check, fault, ok, warning
from daemon.extras import how_to_bring
from drivers.adis16448.configuration import ImuSettings
from drivers.adis16448.device import Adis16448
from drivers.adis16448.probe import LineKind, LineReaction, edges_per_second, is_inverted, line_reaction
from drivers.clock import Clock
from drivers.data_ready import DataReady, DataReadyError, GpiodDataReady, free_inputs

NAME = "data-ready line"
_WATCH_S, _WATCH_EDGES = 0.25, 40  # at least
_GLANCE_S, _GLANCE_EDGES = 0.06, 3
_LEAST_HZ = 5.0

OpenLine = Callable[[], DataReady]
Others = Iterable[tuple[str, OpenLine]]


def examine(device: Adis16448, clock: Clock, open_line: OpenLine | None, others: Others = (), hint: str = "") -> Check:
    """Drive the pin and watch the line; for a silent or strange one look for the settings that would be right.

    Args:
        device: configured.
        clock: of the run.
        open_line: opens the configured line; None: there is none.
        others: other lines, by the setting that chooses them.
        hint: how others could be searched too, if they are not.

    Raises SpiError, ImuError.
    """
    if open_line is None:
        found = "no line is configured: reads are paced by the computer's clock, and part of them meet an update"
        advice = "connect DIO1 to a GPIO and set data_ready_chip and data_ready_line in [imu]"
        return warning(NAME, found, advice)
    settings = device.settings
    try:
        reaction = _watch(device, clock, open_line, settings.data_ready_pin)
    except DataReadyError as error:
        what, _, advice = str(error).rpartition("; ")
        if "missing, install" in str(error):
            what, advice = str(error), how_to_bring("hardware")
        else:
            advice = f"{advice} in [imu] to the line that the wire is on; gpioinfo lists all lines and who uses them"
        return fault(NAME, what, advice)
    if reaction.kind(settings.nominal_rate_hz) is LineKind.FOLLOWS and _is_inverted(device, clock, open_line):
        return fault(
            NAME,
            "the line is inverted: its edges come before the registers change, not after, and bursts are torn",
            f"set data_ready_active_high = {'false' if settings.data_ready_active_high else 'true'} in [imu]",
            edges_driven_hz=round(reaction.on_hz, 1),
        )
    followers: list[str] = []
    if reaction.kind(settings.nominal_rate_hz) in (LineKind.SILENT, LineKind.STRANGER):
        followers = list(_followers(device, clock, open_line, others))
    return judge(reaction, settings, followers, hint)


def judge(reaction: LineReaction, settings: ImuSettings, followers: list[str], hint: str = "") -> Check:
    """What the line's edges mean; `followers` are the settings with which a line would follow."""
    kind, nominal_hz, pin = reaction.kind(settings.nominal_rate_hz), settings.nominal_rate_hz, settings.data_ready_pin
    figures = {
        "edges_driven_hz": round(reaction.on_hz, 1),
        "edges_not_driven_hz": round(reaction.off_hz, 1),
        "followers": followers,
    }
    edges = f"{reaction.on_hz:.0f} edges a second while DIO{pin} is driven, {reaction.off_hz:.0f} while it is not"
    wire = f"check the wire from DIO{pin} to the GPIO line, and data_ready_pin and data_ready_line in [imu]"
    if followers:
        wire = f"set {' or '.join(followers)} in [imu], or change the wire: there the line follows"
    elif hint and kind in (LineKind.SILENT, LineKind.STRANGER):
        wire = f"{wire}; {hint}"
    if kind is LineKind.FOLLOWS:
        return ok(NAME, edges, **figures)
    if kind is LineKind.SILENT:
        return fault(NAME, f"the line is silent: {edges}", wire, **figures)
    if kind is LineKind.STRANGER:
        return fault(NAME, f"the line ticks for another reason than the sensor: {edges}", wire, **figures)
    wanted = f"{edges}, of {nominal_hz:.0f}"
    if kind is LineKind.TOO_FEW:
        return fault(NAME, f"edges are lost: {wanted}", f"check the contact of the wire from DIO{pin}", **figures)
    advice = "the line rings: shorten the wire, with a ground beside it, or put 100 ohm in series"
    return warning(NAME, f"edges are too many: {wanted}", advice, **figures)


def chip_of(settings: ImuSettings) -> node.Node | None:
    """The device file of the line; None if there is none to look at."""
    if settings.transport != "spidev" or settings.data_ready_line is None:
        return None
    switch_on = "load the driver of the GPIO chip (gpiodetect names those that there are)"
    chip = Path(settings.data_ready_chip)
    return node.Node(NAME, chip, "data_ready_chip in [imu]", switch_on, "gpiochip*", is_shared=True)


def other_lines(settings: ImuSettings) -> Others:
    """Lines of the chip on which the pulses might come instead.

    To watch a line is to make it an input of the GPIO block: on some computers that takes a pin away from the SPI
    port or another block, although the kernel calls the line unused. So nobody's lines are watched unasked.
    """
    chip, active_high = settings.data_ready_chip, settings.data_ready_active_high
    for number in free_inputs(chip):
        if number != settings.data_ready_line:
            yield f"data_ready_line = {number}", partial(GpiodDataReady, chip, number, active_high=active_high)


def _watch(device: Adis16448, clock: Clock, open_line: OpenLine, pin: int) -> LineReaction:
    line = open_line()
    try:
        seconds = max(_WATCH_S, _WATCH_EDGES / device.settings.nominal_rate_hz)
        return line_reaction(device, line, clock, pin, seconds)
    finally:
        line.close()


def _is_inverted(device: Adis16448, clock: Clock, open_line: OpenLine) -> bool:
    line = open_line()
    try:
        return is_inverted(device, line, clock)
    finally:
        line.close()


def _followers(device: Adis16448, clock: Clock, open_line: OpenLine, others: Others) -> Iterator[str]:
    """Settings with which the line would follow: the part's other pin on it, or another line."""
    nominal_hz, pin = device.settings.nominal_rate_hz, device.settings.data_ready_pin
    with suppress(DataReadyError):
        if _watch(device, clock, open_line, 3 - pin).kind(nominal_hz) is LineKind.FOLLOWS:
            yield f"data_ready_pin = {3 - pin}"
    for name, open_other in others:
        with suppress(DataReadyError):
            if _ticks(clock, open_other, nominal_hz) and _watch(device, clock, open_other, pin).kind(nominal_hz) is (
                LineKind.FOLLOWS
            ):
                yield name


def _ticks(clock: Clock, open_line: OpenLine, nominal_hz: float) -> bool:
    line = open_line()
    try:
        return edges_per_second(line, clock, max(_GLANCE_S, _GLANCE_EDGES / nominal_hz)) > _LEAST_HZ
    finally:
        line.close()
