from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import pytest

from drivers.can.displacement import build_decoders
from drivers.can.frame import Frame, FrameId
from drivers.can.settings import CanConfigError, CanSettings, DisplacementSettings
from drivers.condition import Wellness
from estimation.records import Displacement, ReadingFault
from tests.drivers.can_kit import about, decoder, emergency, heartbeat, position, read, status, taken

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


def test_support_controller_frame_gives_whole_millimetres_in_metres() -> None:
    reader = decoder()
    assert reader.arbitration_ids == (FrameId(0x310),)
    assert read(reader, status(347)) == Displacement(7, 0.347)
    assert (reader.frames, set(reader.faults.values())) == (1, {0})


def test_value_that_its_source_calls_invalid_is_kept_and_marked() -> None:
    reader = decoder()
    assert read(reader, status(347, valid=0)) == Displacement(7, 0.347, ReadingFault.INVALID)
    assert (reader.faults[ReadingFault.INVALID], sum(reader.faults.values())) == (1, 1)


@pytest.mark.parametrize(("value_mm", "valid"), [(-50, True), (-51, False), (600, True), (601, False)])
def test_value_out_of_range_is_kept_and_marked(value_mm: int, valid: bool) -> None:
    reader = decoder(maximum_mm=600)
    fault = ReadingFault.NONE if valid else ReadingFault.OUT_OF_RANGE
    assert read(reader, status(value_mm)) == Displacement(7, about(value_mm / 1000), fault)
    assert reader.faults[ReadingFault.OUT_OF_RANGE] == (not valid)


@pytest.mark.parametrize("length", [0, 3, 4, 6, 8, 64])
def test_frame_of_wrong_length_is_counted_and_has_no_value(length: int) -> None:
    reader = decoder()
    reading = taken(reader, bytes(length))
    assert math.isnan(reading.value_m)
    assert reading.fault is ReadingFault.MALFORMED
    assert reader.faults[ReadingFault.MALFORMED] == 1


def test_other_frames_are_none_of_its_business() -> None:
    reader = decoder()
    data = status(347)
    others = [
        Frame(1, 0x311, data),
        Frame(1, 0x310, data, is_extended=True),
        Frame(1, 0x310, data, is_error=True),
        Frame(1, 0x310, b"", is_remote=True),
    ]
    assert [reader.decode(frame) for frame in others] == [None] * 4
    assert (reader.frames, sum(reader.faults.values())) == (0, 0)


def test_reference_reading_is_marked_as_such() -> None:
    reader = decoder(True, message="LaboratorySensor", signal="reference_stroke")
    assert reader.arbitration_ids == (FrameId(0x311),)
    assert read(reader, struct.pack("<i", 34_712)) == Displacement(7, 0.34712, is_reference=True)


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
    assert reading == Displacement(7, about(-0.0123))


def test_cia406_position_cut_short_is_malformed() -> None:
    reader = decoder(preset="cia406")
    assert taken(reader, bytes(5)).fault is ReadingFault.MALFORMED


@pytest.mark.parametrize("code", [0x5000, 0x6300, 0xFF00])
def test_cia406_emergency_makes_the_position_invalid_until_it_is_cleared(code: int) -> None:
    reader = decoder(preset="cia406")
    seen = []
    for frame in (emergency(code, 1), emergency(0, 1), emergency(0, 0)):
        assert reader.decode(frame) is None
        reading = taken(reader, position(1230))
        assert reading.value_m == about(0.123)
        seen.append(reading.fault)
    # Cleared only when no other error remains in the error register (CiA 301).
    assert seen == [ReadingFault.INVALID, ReadingFault.INVALID, ReadingFault.NONE]
    assert reader.faults[ReadingFault.INVALID] == 2
    assert reader.report(7).emergencies == 3


@pytest.mark.parametrize("code", [0x8110, 0x8130, 0x8210, 0x82FF])
def test_cia406_emergency_about_communication_leaves_the_position_valid(code: int) -> None:
    reader = decoder(preset="cia406")
    reader.decode(emergency(code, 0x11))
    assert taken(reader, position(1000)).fault is ReadingFault.NONE
    report = reader.report(8)
    assert (report.emergencies, report.condition.word) == (1, Wellness.ILL)
    assert f"0x{code:04X}" in report.condition.what
    assert "still counts" in report.condition.advice
    reader.decode(emergency(0, 0))
    taken(reader, position(1000))
    assert reader.report(8).condition.word is Wellness.OK


def test_cia406_emergency_about_communication_does_not_end_one_about_the_position() -> None:
    reader = decoder(preset="cia406")
    faults = []
    for frame in (emergency(0x5000, 0x21), emergency(0x8130, 0x31), emergency(0, 0x11), emergency(0, 0x21)):
        reader.decode(frame)
        faults.append(taken(reader, position(1000)).fault)
    # The third says that nothing but communication is wrong any more, the fourth that a device error is.
    assert faults == [ReadingFault.INVALID, ReadingFault.INVALID, ReadingFault.NONE, ReadingFault.INVALID]


def test_cia406_sensor_that_boots_anew_has_no_emergency() -> None:
    reader = decoder(preset="cia406")
    reader.decode(emergency(0x5000, 1))
    reader.decode(heartbeat(5))  # operational: proves nothing
    first = taken(reader, position(1230))
    reader.decode(heartbeat(0))
    second = taken(reader, position(1230))
    assert (first.fault, second.fault) == (ReadingFault.INVALID, ReadingFault.NONE)


def test_cia406_emergency_cut_short_is_counted_and_changes_nothing() -> None:
    reader = decoder(preset="cia406")
    reader.decode(Frame(1, 0x0FF, b"\x00\x50"))
    assert taken(reader, position(1230)).valid
    report = reader.report(7)
    assert (report.malformed_emergencies, report.emergencies) == (1, 0)


def test_j1939_frame_has_position_first_and_an_error_byte() -> None:
    reader = decoder(preset="j1939_proprietary_b")
    assert reader.arbitration_ids == (FrameId(0x18FF00F7, True),)
    good = struct.pack("<HhBBBB", 4711, 0, 0, 0, 0, 0xFF)
    bad = struct.pack("<HhBBBB", 4711, 0, 0, 9, 0, 0xFF)
    assert read(reader, good) == Displacement(7, about(0.4711))
    assert read(reader, bad) == Displacement(7, about(0.4711), ReadingFault.INVALID)


@pytest.mark.parametrize(
    ("raw", "fault"),
    [
        (0xFDFF, ReadingFault.NONE),
        (0xFE00, ReadingFault.INVALID),
        (0xFEFF, ReadingFault.INVALID),
        (0xFFFF, ReadingFault.INVALID),
    ],
)
def test_j1939_codes_for_error_and_not_available_are_no_positions(raw: int, fault: ReadingFault) -> None:
    reader = decoder(preset="j1939_proprietary_b", maximum_mm=10_000)
    assert taken(reader, struct.pack("<HhBBBB", raw, 0, 0, 0, 0, 0xFF)).fault is fault


def test_identifier_of_the_dbc_file_can_be_replaced() -> None:
    reader = decoder(preset="j1939_proprietary_b", arbitration_id=0x18FF1280)
    assert reader.arbitration_ids == (FrameId(0x18FF1280, True),)


def test_own_dbc_file_with_big_endian_signal_in_centimetres(own_dbc: Path) -> None:
    reader = decoder(dbc=own_dbc, message="Motorola", signal="Stroke")
    # 0x012C = 300 -> 300 * 0.5 - 100 = 50 cm
    assert read(reader, bytes.fromhex("012C000000000000")) == Displacement(7, about(0.5))


def test_unit_given_by_the_user_wins_over_the_files(own_dbc: Path) -> None:
    reader = decoder(dbc=own_dbc, message="Motorola", signal="Stroke", unit="mm")
    assert read(reader, bytes.fromhex("012C000000000000")) == Displacement(7, about(0.05))


def test_validity_signal_of_an_own_dbc_file(own_dbc: Path) -> None:
    options: dict[str, Any] = {"dbc": own_dbc, "message": "Motorola", "signal": "Stroke"}
    reader = decoder(valid_signal="Plain", valid_value=3, **options)
    readings = [taken(reader, bytes.fromhex(f"012C{plain:04X}00000000")) for plain in (3, 4)]
    assert [reading.valid for reading in readings] == [True, False]


def test_other_pages_of_a_multiplexed_message_carry_no_reading(own_dbc: Path) -> None:
    reader = decoder(dbc=own_dbc, message="Paged", signal="Stroke")
    readings = [read(reader, bytes([page, 100, 0, 0])) for page in (0, 1, 2)]
    assert readings == [Displacement(7, about(0.1)), None, None]
    assert sum(reader.faults.values()) == 0


def test_not_a_number_in_a_float_signal_is_malformed(own_dbc: Path) -> None:
    reader = decoder(dbc=own_dbc, message="Real", signal="Stroke")
    assert read(reader, struct.pack("<f", 0.25)) == Displacement(7, 0.25)
    assert taken(reader, struct.pack("<f", math.nan)).fault is ReadingFault.MALFORMED
    assert taken(reader, struct.pack("<f", math.inf)).fault is ReadingFault.OUT_OF_RANGE


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
