"""A configuration that cannot be used is refused in one sentence with file, line and key."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from daemon.cli import main
from daemon.configuration import ConfigurationError, load
from drivers.can.presets import DBC_FOLDER

CONTROLLER = DBC_FOLDER / "support_controller.dbc"

# What is wrong -> the file, and what is said after "ramstroke: FILE"; {folder} is the file's own.
WRONG_FILES: dict[str, tuple[str, str]] = {
    "unknown key": (
        "[support]\nstroke_mmm = 500\n",
        ":2: [support] stroke_mmm is unknown; did you mean stroke_mm?",
    ),
    "unknown key that resembles none": (
        "[mount]\ncolour = 'red'\n",
        ":2: [mount] colour is unknown; known here: push, up, pitch_deg, roll_deg, heading_deg, imu_on",
    ),
    "metres instead of millimetres": (
        "[support]\nstroke_m = 0.5\n",
        ":2: [support] stroke_m is unknown; did you mean stroke_mm?",
    ),
    "centimetres instead of millimetres": (
        "[support]\nstroke_cm = 50\n",
        ":2: [support] stroke_cm is unknown; did you mean stroke_mm?",
    ),
    "metres per second instead of millimetres": (
        "[support]\nnominal_push_speed_m_s = 0.0145\n",
        ":2: [support] nominal_push_speed_m_s is unknown; did you mean nominal_push_speed_mm_s?",
    ),
    "out of range": (
        "[mount]\n\n[support]\n# longer than any\nstroke_mm = 5000\n",
        ":5: [support] stroke_mm = 5000: must be less than or equal to 2000 (in mm)",
    ),
    "not a number": (
        "[support]\nstroke_mm = nan\n",
        ":2: [support] stroke_mm = nan: must be less than or equal to 2000 (in mm)",
    ),
    "wrong type": (
        '[support]\nstroke_mm = "half a metre"\n',
        ":2: [support] stroke_mm = 'half a metre': must be a valid number (in mm)",
    ),
    "number in quotes": (
        '[support]\nstroke_mm = "500"\n',
        ":2: [support] stroke_mm = '500': must be a valid number (in mm)",
    ),
    "flag for a number": (
        "[imu]\nblock_samples = true\n",
        ":2: [imu] block_samples = True: must be a valid integer (in samples)",
    ),
    "word for a flag": (
        '[can]\nlisten_only = "no"\n',
        ":2: [can] listen_only = 'no': must be a valid boolean",
    ),
    "value that is none of the choices": (
        '[imu]\ntransport = "usb"\n',
        ":2: [imu] transport = 'usb': must be 'spidev', 'socket' or 'virtual'",
    ),
    "unknown section": ("[suport]\nstroke_mm = 500\n", ":1: [suport] is unknown; did you mean support?"),
    "value in place of a section": ("imu = 5\n", ":1: [imu] = 5: must be a section with keys of its own"),
    "unknown dotted key": (
        "support.strok_mm = 500\n",
        ":1: [support] strok_mm is unknown; did you mean stroke_mm?",
    ),
    "unknown key in an inline table": (
        "can = {channel = 'can1', displacement = {units = 'mm'}}\n",
        ":1: [can.displacement] units is unknown; did you mean unit?",
    ),
    "bad TOML": (
        "[support]\nstroke_mm =\n",
        ": is not valid TOML: Invalid value (at line 2, column 12)",
    ),
    "section twice": (
        "[support]\n\n[support]\n",
        ": is not valid TOML: Cannot declare ('support',) twice (at line 3, column 9)",
    ),
    "push and up on the same axis": (
        '[mount]\nup = "-y"\npush = "+y"\n',
        ":3: [mount] push = '+y' and up = '-y' lie on the same axis; name two axes",
    ),
    "initial stroke beyond the stroke": (
        "[support]\nstroke_mm = 400\ninitial_mm = 450\n",
        ":3: [support] initial_mm = 450 lies beyond stroke_mm = 400",
    ),
    "publishing while listening only": (
        '[can]\nchannel = "can1"\n\n[can.publish]\nenabled = true\n',
        ":5: [can] `publish.enabled` needs the right to send: set `listen_only = false` or disable publishing",
    ),
    "virtual bus beside a real sensor": (
        '[can]\ninterface = "virtual"\n',
        ':2: can.interface = "virtual" exists only within one process: with imu.transport = "spidev" choose '
        '"socketcan", or set can.enabled = false',
    ),
    "network address that is none": (
        '[can]\ninterface = "udp_multicast"\nchannel = "can0"\n',
        ':3: [can] `channel` "can0" is no multicast address: udp_multicast needs one, such as 239.74.163.2',
    ),
    "budget below one file": (
        "[recording]\nbudget_mb = 10\n",
        ":2: [recording] budget_mb = 10 is smaller than one file (rotate_mb = 256): raise budget_mb or lower rotate_mb",
    ),
    "preset and DBC file": (
        '[can.displacement]\npreset = "cia406"\ndbc = "own.dbc"\n',
        ":2: [can.displacement] `preset` and `dbc` exclude each other: delete one of them",
    ),
    "missing DBC file": (
        '[can.displacement]\nmessage = "Ram"\nsignal = "stroke"\ndbc = "none.dbc"\n',
        ":4: [can.displacement] Cannot read the DBC file {folder}/none.dbc (option `dbc`): No such file or "
        "directory; correct the path or its permissions.",
    ),
    "message that is not in the DBC file": (
        '[can.displacement]\nmessage = "Ram"\n',
        f':2: [can.displacement] The DBC file {CONTROLLER} has no message "Ram" (option `message`); '
        "it has LaboratorySensor, SupportStatus.",
    ),
    "signal that is not in the DBC file": (
        '[can.displacement]\nsignal = "ram"\n',
        ':2: [can.displacement] Message "SupportStatus" has no signal "ram" (option `signal`); '
        "it has checksum, counter, ram_stroke, ram_stroke_valid.",
    ),
    "reference signal that is not in the DBC file": (
        '[can.displacement]\n[can.reference]\nmessage = "LaboratorySensor"\nsignal = "ram"\n',
        ':4: [can.reference] Message "LaboratorySensor" has no signal "ram" (option `signal`); '
        "it has reference_stroke.",
    ),
    "reference that is the observed signal": (
        "[can]\nenabled = true\n[can.reference]\n",
        ':1: [can] `displacement` and `reference` both read signal "ram_stroke" of frame 0x310: name the '
        "laboratory sensor's message and signal in `reference`.",
    ),
}


@pytest.mark.parametrize("what", WRONG_FILES)
def test_a_wrong_file_is_refused_in_one_sentence(what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, said = WRONG_FILES[what]
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    assert main(["check-config", str(path)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err == f"ramstroke: {path}{said}\n".replace("{folder}", str(tmp_path))


def test_every_command_with_a_configuration_refuses_a_wrong_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text("[support]\nstroke_m = 1\n")
    for command in (
        ["run", "--config"],
        ["sim", "--config"],
        ["status", "--config"],
        ["replay", "none.mcap", "--config"],
        ["import", "none.csv", "-o", "none.mcap", "--config"],
    ):
        assert main([*command, str(path)]) == 2, command
        assert capsys.readouterr().err == (
            f"ramstroke: {path}:2: [support] stroke_m is unknown; did you mean stroke_mm?\n"
        )


def test_every_fault_of_a_file_gets_its_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text("[support]\nstroke_mm = 1\ninitial_mm = -1\nspeed = 2\n")
    assert main(["check-config", str(path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[1] for line in lines] == [f"{path}:2", f"{path}:3", f"{path}:4"]


def refusal_of(path: Path) -> str:
    with pytest.raises(ConfigurationError) as refused:
        load(path)
    (sentence,) = refused.value.sentences
    return sentence.removeprefix(str(path))


def test_what_is_no_readable_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    assert refusal_of(path) == ": cannot be read: No such file or directory"
    assert refusal_of(tmp_path) == ": cannot be read: Is a directory"
    path.write_bytes(b"# Gr\xfc\xdfe\n")
    assert refusal_of(path) == ": is no text file (UTF-8)"
    path.write_bytes(b"#" * 1_000_001)
    assert refusal_of(path) == ": is larger than 1 MB and no configuration file"


@pytest.mark.parametrize("text", ["a = " + "[" * 5000 + "]" * 5000, "[support]\nstroke_mm = " + "9" * 5000])
def test_a_file_made_to_do_harm_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    assert refusal_of(path).startswith(": is not valid TOML: ")


def test_a_huge_value_is_not_repeated_whole(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(f'[imu]\ntransport = "{"x" * 500_000}"\n')
    sentence = refusal_of(path)
    assert sentence.startswith(":2: [imu] transport = 'xxxx")
    assert len(sentence) < 200


def test_a_relative_dbc_path_counts_from_the_configuration_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.dbc").write_bytes(CONTROLLER.read_bytes())
    path = tmp_path / "good.toml"
    path.write_text('[can.displacement]\ndbc = "own.dbc"\nmessage = "SupportStatus"\nsignal = "ram_stroke"\n')
    monkeypatch.chdir("/")
    assert load(path).can.displacement.dbc == tmp_path / "own.dbc"


def test_an_empty_file_and_one_with_a_byte_order_mark_are_good(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "[red]good.toml"  # a name that looks like markup
    path.write_text("")
    assert main(["check-config", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: good\n"
    path.write_bytes(b"\xef\xbb\xbf[support]\r\nstroke_mm = 700\r\n")
    assert load(path).support.stroke_mm == 700


def test_can_that_is_disabled_needs_no_dbc_file(tmp_path: Path) -> None:
    path = tmp_path / "good.toml"
    path.write_text('[can]\nenabled = false\n[can.displacement]\nsignal = "ram"\n')
    assert not load(path).can.enabled


def test_check_config_says_the_same_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.toml"
    path.write_text("[support]\nstroke_mm = 500\n")
    assert main(["check-config", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": str(path), "good": True, "faults": []}
    path.write_text("[support]\nstroke_m = 500\n")
    assert main(["check-config", str(path), "--json"]) == 2
    printed = capsys.readouterr()
    assert json.loads(printed.out) == {
        "file": str(path),
        "good": False,
        "faults": [f"{path}:2: [support] stroke_m is unknown; did you mean stroke_mm?"],
    }
    assert printed.err == ""
