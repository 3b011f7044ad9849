from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.displacement import DisplacementDecoder, build_decoders
from drivers.can.frame import Frame, FrameId
from drivers.can.presets import PRESETS
from drivers.can.settings import CanConfigError, CanSettings, DisplacementSettings
from estimation.records import Displacement

about: Any = pytest.approx  # so that it may stand for a float

OWN_DBC = """VERSION ""
BU_: A
BO_ 291 Motorola: 8 A
 SG_ Stroke : 7|16@0+ (0.5,-100) [0|0] "cm" A
 SG_ Plain : 23|16@0+ (1,0) [0|0] "" A
 SG_ Turns : 39|16@0+ (1,0) [0|0] "rpm" A
 SG_ Metres : 55|8@0- (0.01,0) [0|0] "m" A
BO_ 292 Paged: 4 A
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" A
 SG_ Stroke m0 : 8|16@1+ (1,0) [0|0] "mm" A
 SG_ Pressure m1 : 8|16@1+ (1,0) [0|0] "bar" A
BO_ 293 Real: 4 A
 SG_ Stroke : 0|32@1- (1,0) [0|0] "m" A
BO_ 294 Overlong: 2 A
 SG_ Stroke : 0|32@1- (1,0) [0|0] "mm" A
SIG_VALTYPE_ 293 Stroke : 1;
"""


@pytest.fixture
def own_dbc(tmp_path: Path) -> Path:
    path = tmp_path / "own.dbc"
    path.write_text(OWN_DBC, encoding="cp1252")
    return path


def decoder(is_reference: bool = False, **options: Any) -> DisplacementDecoder:
    return DisplacementDecoder(DisplacementSettings.model_validate(options), is_reference)


def read(reader: DisplacementDecoder, data: bytes, t_ns: int = 7) -> Displacement | None:
    """Decode `data` as if it came under the reader's own identifier."""
    arbitration_id, is_extended = reader.arbitration_ids[0]
    return reader.decode(Frame(t_ns, arbitration_id, data, is_extended=is_extended))


def test_support_controller_frame_gives_whole_millimetres_in_metres() -> None:
    reader = decoder()
    assert reader.arbitration_ids == (FrameId(0x310),)
    assert read(reader, struct.pack("<hBB", 347, 1, 0)) == Displacement(7, 0.347, True)
    assert (reader.malformed, reader.out_of_range, reader.invalid) == (0, 0, 0)


def test_value_that_its_source_calls_invalid_is_kept_and_marked() -> None:
    reader = decoder()
    assert read(reader, struct.pack("<hBB", 347, 0, 0)) == Displacement(7, 0.347, False)
    assert (reader.invalid, reader.out_of_range) == (1, 0)


@pytest.mark.parametrize(("value_mm", "valid"), [(-50, True), (-51, False), (600, True), (601, False)])
def test_value_out_of_range_is_kept_and_marked(value_mm: int, valid: bool) -> None:
    reader = decoder(maximum_mm=600)
    reading = read(reader, struct.pack("<hBB", value_mm, 1, 0))
    assert reading == Displacement(7, about(value_mm / 1000), valid)
    assert reader.out_of_range == (not valid)


@pytest.mark.parametrize("length", [0, 3, 5, 8, 64])
def test_frame_of_wrong_length_is_counted_and_has_no_value(length: int) -> None:
    reader = decoder()
    reading = read(reader, bytes(length))
    assert reading is not None
    assert math.isnan(reading.value_m)
    assert not reading.valid
    assert reader.malformed == 1


def test_other_frames_are_none_of_its_business() -> None:
    reader = decoder()
    data = struct.pack("<hBB", 347, 1, 0)
    others = [
        Frame(1, 0x311, data),
        Frame(1, 0x310, data, is_extended=True),
        Frame(1, 0x310, data, is_error=True),
        Frame(1, 0x310, b"", is_remote=True),
    ]
    assert [reader.decode(frame) for frame in others] == [None] * 4
    assert reader.malformed == 0


def test_reference_reading_is_marked_as_such() -> None:
    reader = decoder(True, message="LaboratorySensor", signal="reference_stroke")
    assert reader.arbitration_ids == (FrameId(0x311),)
    assert read(reader, struct.pack("<i", 34_712)) == Displacement(7, 0.34712, True, is_reference=True)


def test_cia406_node_number_moves_all_identifiers() -> None:
    assert decoder(preset="cia406").arbitration_ids == (FrameId(0x1FF), FrameId(0x0FF), FrameId(0x77F))
    assert decoder(preset="cia406", node_id=5).arbitration_ids == (
        FrameId(0x185),
        FrameId(0x085),
        FrameId(0x705),
    )


def test_cia406_position_may_sit_in_another_pdo_of_the_node() -> None:
    reader = decoder(preset="cia406", node_id=5, arbitration_id=0x285)
    assert reader.arbitration_ids == (FrameId(0x285), FrameId(0x085), FrameId(0x705))


@pytest.mark.parametrize("appended", [b"", b"\x00", b"\x00\x00"])
def test_cia406_position_counts_tenths_of_a_millimetre_and_may_have_status_bytes(appended: bytes) -> None:
    reading = read(decoder(preset="cia406"), struct.pack("<ih", -123, 14) + appended)
    assert reading == Displacement(7, about(-0.0123), True)


def test_cia406_position_cut_short_is_malformed() -> None:
    reader = decoder(preset="cia406")
    read(reader, bytes(5))
    assert reader.malformed == 1


def emergency(code: int, register: int = 0) -> Frame:
    return Frame(1, 0x0FF, struct.pack("<HB5x", code, register))


@pytest.mark.parametrize("code", [0x5000, 0x6300, 0xFF00])
def test_cia406_emergency_makes_the_position_invalid_until_it_is_cleared(code: int) -> None:
    reader = decoder(preset="cia406")
    position = struct.pack("<ih", 1230, 0)
    seen = []
    for frame in (emergency(code, 1), emergency(0, 1), emergency(0, 0)):
        assert reader.decode(frame) is None
        reading = read(reader, position)
        assert reading is not None
        assert reading.value_m == about(0.123)
        seen.append(reading.valid)
    # Cleared only when no other error remains in the error register (CiA 301).
    assert seen == [False, False, True]
    assert reader.invalid == 2
    assert reader.emergency is not None
    assert reader.emergency.received == 3


def test_cia406_sensor_that_boots_anew_has_no_emergency() -> None:
    reader = decoder(preset="cia406")
    reader.decode(emergency(0x5000, 1))
    reader.decode(Frame(1, 0x77F, b"\x05"))  # heartbeat "operational" proves nothing
    first = read(reader, struct.pack("<ih", 1230, 0))
    reader.decode(Frame(1, 0x77F, b"\x00"))
    second = read(reader, struct.pack("<ih", 1230, 0))
    assert first is not None
    assert second is not None
    assert (first.valid, second.valid) == (False, True)


def test_cia406_emergency_cut_short_is_counted_and_changes_nothing() -> None:
    reader = decoder(preset="cia406")
    reader.decode(Frame(1, 0x0FF, b"\x00\x50"))
    reading = read(reader, struct.pack("<ih", 1230, 0))
    assert reading is not None
    assert reading.valid
    assert reader.emergency is not None
    assert (reader.emergency.malformed, reader.emergency.received) == (1, 0)


def test_j1939_frame_has_position_first_and_an_error_byte() -> None:
    reader = decoder(preset="j1939_proprietary_b")
    assert reader.arbitration_ids == (FrameId(0x18FF00F7, True),)
    good = struct.pack("<HhBBBB", 4711, 0, 0, 0, 0, 0xFF)
    bad = struct.pack("<HhBBBB", 4711, 0, 0, 9, 0, 0xFF)
    assert read(reader, good) == Displacement(7, about(0.4711), True)
    assert read(reader, bad) == Displacement(7, about(0.4711), False)


@pytest.mark.parametrize("raw", [0xFE00, 0xFFFF])
def test_j1939_codes_for_error_and_not_available_are_never_valid(raw: int) -> None:
    reading = read(decoder(preset="j1939_proprietary_b"), struct.pack("<HhBBBB", raw, 0, 0, 0, 0, 0xFF))
    assert reading is not None
    assert not reading.valid


def test_identifier_of_the_dbc_file_can_be_replaced() -> None:
    reader = decoder(preset="j1939_proprietary_b", arbitration_id=0x18FF1280)
    assert reader.arbitration_ids == (FrameId(0x18FF1280, True),)


def test_own_dbc_file_with_big_endian_signal_in_centimetres(own_dbc: Path) -> None:
    reader = decoder(dbc=own_dbc, message="Motorola", signal="Stroke")
    # 0x012C = 300 -> 300 * 0.5 - 100 = 50 cm
    assert read(reader, bytes.fromhex("012C000000000000")) == Displacement(7, about(0.5), True)


def test_unit_given_by_the_user_wins_over_the_files(own_dbc: Path) -> None:
    reader = decoder(dbc=own_dbc, message="Motorola", signal="Stroke", unit="mm")
    assert read(reader, bytes.fromhex("012C000000000000")) == Displacement(7, about(0.05), True)


def test_validity_signal_of_an_own_dbc_file(own_dbc: Path) -> None:
    options: dict[str, Any] = {"dbc": own_dbc, "message": "Motorola", "signal": "Stroke"}
    reader = decoder(valid_signal="Plain", valid_value=3, **options)
    valid = [read(reader, bytes.fromhex(f"012C{plain:04X}00000000")) for plain in (3, 4)]
    assert [reading.valid for reading in valid if reading] == [True, False]


def test_other_pages_of_a_multiplexed_message_carry_no_reading(own_dbc: Path) -> None:
    reader = decoder(dbc=own_dbc, message="Paged", signal="Stroke")
    readings = [read(reader, bytes([page, 100, 0, 0])) for page in (0, 1, 2)]
    assert readings == [Displacement(7, about(0.1), True), None, None]
    assert reader.malformed == 0


def test_not_a_number_in_a_float_signal_is_malformed(own_dbc: Path) -> None:
    reader = decoder(dbc=own_dbc, message="Real", signal="Stroke")
    assert read(reader, struct.pack("<f", 0.25)) == Displacement(7, 0.25, True)
    nothing = read(reader, struct.pack("<f", math.nan))
    assert nothing is not None
    assert not nothing.valid
    assert reader.malformed == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"message": "Nope"}, ["own.dbc", '"Nope"', "`message`", "Motorola, Overlong, Paged, Real"]),
        ({"signal": "Nope"}, ['"Nope"', "`signal`", "Metres, Plain, Stroke, Turns"]),
        ({"valid_signal": "Nope"}, ['"Nope"', "`valid_signal`", "Metres"]),
        ({"signal": "Plain"}, ['"Plain" has no unit', "`unit`", "mm, cm, m or um"]),
        ({"signal": "Turns"}, ['"Turns" has the unit "rpm"', "`unit`"]),
        ({"message": "Overlong"}, ['"Overlong"', "contradicts itself"]),
        ({"arbitration_id": 0x800}, ["`arbitration_id` 0x800", "11 bits", '"Motorola"']),
    ],
)
def test_settings_that_do_not_fit_the_dbc_file_are_refused_in_one_sentence(
    own_dbc: Path, options: dict[str, Any], words: list[str]
) -> None:
    with pytest.raises(CanConfigError) as refusal:
        decoder(**{"dbc": own_dbc, "message": "Motorola", "signal": "Stroke", **options})
    text = str(refusal.value)
    assert [word for word in words if word not in text] == []
    assert "\n" not in text


def test_long_lists_of_names_are_cut(tmp_path: Path) -> None:
    path = tmp_path / "many.dbc"
    path.write_text('VERSION ""\nBU_: A\n' + "".join(f"BO_ {i} M{i:02d}: 8 A\n\n" for i in range(1, 31)))
    with pytest.raises(CanConfigError, match="M12 and 18 more"):
        decoder(dbc=path, message="Nope", signal="s")


def test_missing_dbc_file_is_named_with_its_option(tmp_path: Path) -> None:
    with pytest.raises(CanConfigError, match=r"gone\.dbc \(option `dbc`\): No such file"):
        decoder(dbc=tmp_path / "gone.dbc", message="M", signal="s")


@pytest.mark.parametrize("content", [b"\x00\xff\x81\x8d" * 9, b"BO_ x", b"VERSION 5"])
def test_damaged_dbc_file_is_refused_in_words(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "damaged.dbc"
    path.write_bytes(content)
    with pytest.raises(CanConfigError, match=r"damaged\.dbc \(option `dbc`\) is no usable DBC file") as refusal:
        decoder(dbc=path, message="M", signal="s")
    assert "\n" not in str(refusal.value)


def test_enormous_dbc_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "huge.dbc"
    with path.open("wb") as file:
        file.truncate(9_000_000)
    with pytest.raises(CanConfigError, match="9000000 bytes"):
        decoder(dbc=path, message="M", signal="s")


DECODERS = [decoder(preset=preset) for preset in PRESETS]


@settings(derandomize=True, deadline=None)
@given(
    data=st.binary(max_size=64),
    which=st.sampled_from(DECODERS),
    own=st.integers(0, 2),
    flags=st.integers(0, 3),
)
def test_no_bytes_whatever_make_the_decoder_raise(
    data: bytes, which: DisplacementDecoder, own: int, flags: int
) -> None:
    ids = which.arbitration_ids
    arbitration_id, is_extended = ids[own % len(ids)]
    frame = Frame(1, arbitration_id, data, is_extended, is_error=bool(flags & 1), is_remote=bool(flags & 2))
    reading = which.decode(frame)
    assert reading is None or reading.valid <= (-0.05 <= reading.value_m <= 1.0)


def test_observed_and_reference_come_from_two_decoders() -> None:
    reference = {"message": "LaboratorySensor", "signal": "reference_stroke"}
    observed, laboratory = build_decoders(CanSettings.model_validate({"reference": reference}))
    assert laboratory is not None
    assert (observed.arbitration_ids, laboratory.arbitration_ids) == ((FrameId(0x310),), (FrameId(0x311),))
    assert build_decoders(CanSettings())[1] is None


def test_reference_must_not_be_the_observed_signal_itself() -> None:
    with pytest.raises(CanConfigError, match='both read signal "ram_stroke" of frame 0x310'):
        build_decoders(CanSettings(reference=DisplacementSettings()))


def test_estimate_must_not_be_sent_under_an_identifier_that_is_read() -> None:
    publish = {"enabled": True, "arbitration_id": 0x310}
    with pytest.raises(CanConfigError, match="0x310 is the identifier of a frame that is read"):
        build_decoders(CanSettings.model_validate({"listen_only": False, "publish": publish}))
    build_decoders(CanSettings.model_validate({"listen_only": False, "publish": publish | {"extended": True}}))
