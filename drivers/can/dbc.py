"""From settings to the one signal of the one message that carries a displacement."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cantools.database
from cantools.database.can import Database, Message, Signal

from drivers.can import cia406
from drivers.can.frame import Frame, FrameId
from drivers.can.presets import PRESETS, Preset
from drivers.can.protection import ChecksumSignal, CounterSignal, checksum_signal, counter_signal
from drivers.can.settings import CanConfigError, DisplacementSettings

# Real files stay below 2 MB; a larger one would hold up the start for minutes.
_LARGEST_DBC_BYTES = 8_000_000
_NAMES_SHOWN = 12
# What a CAN FD frame can hold beyond a classic one (ISO 11898-1); shorter messages are padded.
_FD_LENGTHS = (8, 12, 16, 20, 24, 32, 48, 64)
# Divided by, not multiplied with a fraction: 347 mm / 1000 is exactly the float 0.347.
_UNITS_PER_METRE = {"m": 1, "cm": 100, "mm": 1000, "um": 1_000_000, "µm": 1_000_000, "μm": 1_000_000}


@dataclass(slots=True, frozen=True)
class DisplacementSignal:
    """A displacement signal with all that is needed to read or write it."""

    frame_id: FrameId
    message: Message
    signal: Signal
    units_per_metre: int
    valid_signal: Signal | None
    valid_value: int  # raw
    counter: CounterSignal | None
    checksum: ChecksumSignal | None
    lowest_code: int | None  # raw values from here on are codes, no positions
    may_be_longer: bool
    padded_length: int  # of an FD frame
    node_id: int | None  # CANopen node, None for anything else

    def accepts_length(self, frame: Frame) -> bool:
        """Whether `frame` is as long as this message, or as a CAN FD frame that is padded to hold it."""
        length, wanted = len(frame.data), self.message.length
        return (
            length == wanted
            or (self.may_be_longer and length > wanted)
            or (frame.is_fd and length == self.padded_length)
        )


def find_signal(settings: DisplacementSettings) -> DisplacementSignal:
    """Look up the signal that `settings` names.

    Raises:
        CanConfigError: the DBC file, the message, a signal or its unit is missing or unusable.
    """
    layout = _layout(settings)
    database = _load(layout.dbc)
    message = _message(database, layout)
    signal = _signal(message, layout.signal, "signal")
    valid = _companion(message, signal, layout.valid_signal, "valid_signal")
    counter = _companion(message, signal, layout.counter_signal, "counter_signal")
    checksum = _companion(message, signal, layout.checksum_signal, "checksum_signal")
    node_id = (settings.node_id or cia406.DEFAULT_NODE) if settings.preset == "cia406" else None
    return DisplacementSignal(
        frame_id=_frame_id(settings, message, node_id),
        message=message,
        signal=signal,
        units_per_metre=_units_per_metre(settings, signal),
        valid_signal=valid,
        valid_value=layout.valid_value,
        counter=None if counter is None else counter_signal(counter),
        checksum=(
            None if checksum is None or layout.checksum is None else checksum_signal(message, checksum, layout.checksum)
        ),
        lowest_code=layout.lowest_code,
        may_be_longer=layout.may_be_longer,
        padded_length=next((length for length in _FD_LENGTHS if length >= message.length), message.length),
        node_id=node_id,
    )


def signal_name(settings: DisplacementSettings) -> str:
    """Which signal that is, in words; the DBC file is not read."""
    layout = _layout(settings)
    words = [f"{layout.message}.{layout.signal}"]
    if settings.arbitration_id is not None:
        words.append(f"on 0x{settings.arbitration_id:X}")
    if settings.node_id is not None:
        words.append(f"of node {settings.node_id}")
    return " ".join(words)


def _layout(settings: DisplacementSettings) -> Preset:
    """The preset with the user's overrides, or the user's own layout."""
    if settings.preset is None:
        assert settings.dbc is not None
        assert settings.message is not None
        assert settings.signal is not None
        layout = Preset(settings.dbc, settings.message, settings.signal)
    else:
        layout = PRESETS[settings.preset]
        message, signal = settings.message or layout.message, settings.signal or layout.signal
        if message != layout.message:  # what belongs to the preset's message does not belong to another one
            layout = Preset(layout.dbc, message, signal, may_be_longer=layout.may_be_longer)
        elif signal != layout.signal:
            layout = replace(layout, signal=signal, lowest_code=None)
    if settings.valid_signal is not None:
        valid_value = 1 if settings.valid_value is None else settings.valid_value
        layout = replace(layout, valid_signal=settings.valid_signal, valid_value=valid_value)
    if settings.counter_signal is not None:
        layout = replace(layout, counter_signal=settings.counter_signal)
    if settings.checksum_signal is not None:
        layout = replace(layout, checksum_signal=settings.checksum_signal, checksum=settings.checksum)
    return layout


def _load(path: Path) -> Database:
    try:
        size = path.stat().st_size
        if size > _LARGEST_DBC_BYTES:
            raise CanConfigError(
                f"The DBC file {path} (option `dbc`) has {size} bytes, more than {_LARGEST_DBC_BYTES}: "
                "export only the messages that are needed."
            )
        # Not strict: overlapping signals of messages that we do not use are none of our business.
        database = cantools.database.load_file(path, database_format="dbc", strict=False)
    except OSError as error:
        reason = error.strerror or str(error)
        raise CanConfigError(
            f"Cannot read the DBC file {path} (option `dbc`): {reason}; correct the path or its permissions."
        ) from error
    except CanConfigError:
        raise
    except Exception as error:  # a damaged file makes the parser raise all sorts of things
        raise CanConfigError(f"The file {path} (option `dbc`) is no usable DBC file: {error}.") from error
    assert isinstance(database, Database)
    return database


def _message(database: Database, layout: Preset) -> Message:
    messages = {message.name: message for message in database.messages}
    if layout.message not in messages:
        raise CanConfigError(
            f'The DBC file {layout.dbc} has no message "{layout.message}" (option `message`); '
            f"it has {_names(messages)}."
        )
    message = messages[layout.message]
    try:
        message.refresh(strict=True)
    except Exception as error:
        raise CanConfigError(
            f'Message "{message.name}" of the DBC file {layout.dbc} contradicts itself: {error}.'
        ) from error
    return message


def _signal(message: Message, name: str, option: str) -> Signal:
    signals = {signal.name: signal for signal in message.signals}
    if name not in signals:
        raise CanConfigError(
            f'Message "{message.name}" has no signal "{name}" (option `{option}`); it has {_names(signals)}.'
        )
    return signals[name]


def _companion(message: Message, signal: Signal, name: str | None, option: str) -> Signal | None:
    """The signal `name` of the message, which every frame with the displacement `signal` must hold."""
    if name is None:
        return None
    companion = _signal(message, name, option)
    own, pages = signal.multiplexer_ids, companion.multiplexer_ids
    if name == signal.name or (pages and not (own and set(own) <= set(pages))):
        raise CanConfigError(
            f'Signal "{name}" (option `{option}`) does not stand beside "{signal.name}" in the same frame: '
            "name another one."
        )
    return companion


def _names(found: dict[str, Message] | dict[str, Signal]) -> str:
    names = sorted(found)
    rest = len(names) - _NAMES_SHOWN
    return (", ".join(names[:_NAMES_SHOWN]) or "none") + (f" and {rest} more" if rest > 0 else "")


def _units_per_metre(settings: DisplacementSettings, signal: Signal) -> int:
    unit = settings.unit or signal.unit or ""
    if unit not in _UNITS_PER_METRE:
        stated = f'has the unit "{unit}"' if unit else "has no unit"
        raise CanConfigError(
            f'Signal "{signal.name}" {stated} in the DBC file: set the option `unit` to mm, cm, m or um.'
        )
    return _UNITS_PER_METRE[unit]


def _frame_id(settings: DisplacementSettings, message: Message, node_id: int | None) -> FrameId:
    if settings.arbitration_id is not None:
        width = 29 if message.is_extended_frame else 11
        if settings.arbitration_id >> width:
            raise CanConfigError(
                f"The option `arbitration_id` 0x{settings.arbitration_id:X} does not fit the {width} bits of "
                f'message "{message.name}": choose a smaller one.'
            )
        return FrameId(settings.arbitration_id, message.is_extended_frame)
    if node_id is not None:
        return cia406.position_id(node_id)
    return FrameId(message.frame_id, message.is_extended_frame)
