"""A fault script that cannot be used is refused in one sentence with file, line and key; ours are good."""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.cli import main
from daemon.simulation.fault_file import load_faults
from daemon.simulation.fault_reference import generate
from daemon.toml_errors import ConfigurationError
from drivers.virtual.faults import KINDS, Fault, FaultScript, Flood, Jump

HOUSE = Path(__file__).parents[2]
SCRIPTS = HOUSE / "config" / "faults"
HEAD = "[[fault]]\nkind = "
ALL_KINDS = ", ".join(KINDS)

# What is wrong -> the file, and what is said after its name.
WRONG_FILES: dict[str, tuple[str, str]] = {
    "bad TOML": (
        "[[fault]\n",
        ": is not valid TOML: Expected ']]' at the end of an array declaration (at line 1, column 8)",
    ),
    "misspelt kind": (
        f'{HEAD}"miso_lo"\nat_s = 1\nfor_s = 2\n',
        ":2: fault 1: kind = 'miso_lo' is unknown; did you mean miso_low?",
    ),
    "kind that resembles none": (
        f'{HEAD}"x"\nat_s = 1\nfor_s = 2\n',
        f":2: fault 1: kind = 'x' is unknown; known here: {ALL_KINDS}",
    ),
    "no kind": ("seed = 3\n\n[[fault]]\nat_s = 1\n", f":3: fault 1: kind is missing; known are {ALL_KINDS}"),
    "no end": (f'{HEAD}"miso_low"\nat_s = 1\n', ":1: fault 1 (miso_low): for_s is missing (in s)"),
    "no parameter": (
        f'{HEAD}"miso_low"\nat_s = 1\nfor_s = 1\n{HEAD}"drift"\nat_s = 1\nfor_s = 1\n',
        ":5: fault 2 (drift): mm_s is missing (in mm/s)",
    ),
    "negative time": (
        f'{HEAD}"miso_low"\nfor_s = 1\nat_s = -1\n',
        ":4: fault 1 (miso_low): at_s = -1: must be greater than or equal to 0 (in s)",
    ),
    "no duration": (
        f'{HEAD}"miso_low"\nfor_s = 0\nat_s = 1\n',
        ":3: fault 1 (miso_low): for_s = 0: must be greater than 0 (in s)",
    ),
    "text for a number": (
        f'{HEAD}"miso_low"\nfor_s = "1"\nat_s = 1\n',
        ":3: fault 1 (miso_low): for_s = '1': must be a valid number (in s)",
    ),
    "no number": (
        f'{HEAD}"bit_flips"\nfor_s = 1\nat_s = 1\nprobability = nan\n',
        ":5: fault 1 (bit_flips): probability = nan: must be less than or equal to 0.5",
    ),
    "another unit": (
        f'{HEAD}"jump"\nfor_s = 1\nat_s = 1\noffset_mm = 1\noffset_m = 0.04\n',
        ":6: fault 1 (jump): offset_m is unknown; did you mean offset_mm?",
    ),
    "key of another kind": (
        f'{HEAD}"miso_low"\nfor_s = 1\nat_s = 1\nsigma_mm = 3\n',
        ":5: fault 1 (miso_low): sigma_mm is unknown; known here: at_s, for_s, kind",
    ),
    "none of the choices": (
        f'{HEAD}"overrange"\nfor_s = 1\nat_s = 1\naxis = "z"\n',
        ":5: fault 1 (overrange): axis = 'z': must be 'x_gyro', 'y_gyro', 'z_gyro', 'x_accl', 'y_accl' or 'z_accl'",
    ),
    "no parts": (
        f'{HEAD}"self_test_failure"\nfor_s = 1\nat_s = 1\nparts = []\n',
        ":5: fault 1 (self_test_failure): parts names nothing",
    ),
    "unknown part": (
        f'{HEAD}"self_test_failure"\nfor_s = 1\nat_s = 1\nparts = ["gyro"]\n',
        ":5: fault 1 (self_test_failure): parts = 'gyro': must be 'x_gyro', 'y_gyro', 'z_gyro', 'x_accl', 'y_accl', "
        "'z_accl', 'memory', 'barometer' or 'magnetometer'",
    ),
    "identifier beyond 11 bits": (
        f'{HEAD}"flood"\nfor_s = 1\nat_s = 1\narbitration_id = 0x800\n',
        ":5: fault 1 (flood): arbitration_id = 2048: must be less than or equal to 2047",
    ),
    "misspelt seed": ("sed = 1\n", ":1: sed is unknown; did you mean seed?"),
    "negative seed": ("seed = -1\n", ":1: seed = -1: must be greater than or equal to 0"),
    "one table instead of several": (
        '[fault]\nkind = "jump"\n',
        ":1: every fault is a table that begins with [[fault]]",
    ),
    "a number among the faults": ("fault = [3]\n", ": fault 1: every fault is a table that begins with [[fault]]"),
}


@pytest.mark.parametrize("what", WRONG_FILES)
def test_a_wrong_script_is_refused_in_one_sentence(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, said = WRONG_FILES[what]
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    assert main(["demo", "--out", str(tmp_path / "out"), "--faults", str(path)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err == f"ramstroke: {path}{said}\n"
    assert not (tmp_path / "out").exists()


def test_every_fault_of_a_script_gets_its_sentence(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(f'sed = 1\n{HEAD}"jump"\nat_s = -1\nfor_s = 1\n\n{HEAD}"miso"\n')
    with pytest.raises(ConfigurationError) as refused:
        load_faults(path)
    assert [sentence.split(": ")[0] for sentence in refused.value.sentences] == [
        f"{path}:4",
        f"{path}:2",
        f"{path}:8",
        f"{path}:1",
    ]


def test_a_script_that_cannot_be_read_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing, large = tmp_path / "missing.toml", tmp_path / "large.toml"
    large.write_bytes(b"#" * 1_000_001)
    for path, said in (
        (missing, "cannot be read: No such file or directory"),
        (large, "is larger than 1 MB and no fault script"),
    ):
        assert main(["demo", "--faults", str(path)]) == 2
        assert capsys.readouterr().err == f"ramstroke: {path}: {said}\n"


def test_sim_refuses_a_wrong_script_and_one_that_needs_another_interface(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, faults = tmp_path / "trial.toml", tmp_path / "faults.toml"
    config.write_text(
        f'[imu]\ntransport = "socket"\nsocket_path = "{tmp_path}/imu"\n'
        '[can]\ninterface = "udp_multicast"\nchannel = "239.74.163.78"\n'
    )
    faults.write_text(f'{HEAD}"miso"\n')
    assert main(["sim", "--config", str(config), "--faults", str(faults)]) == 2
    assert f"ramstroke: {faults}:2: fault 1: kind = 'miso' is unknown" in capsys.readouterr().err
    faults.write_text(f'{HEAD}"interface_down"\nat_s = 1\nfor_s = 1\n')
    assert main(["sim", "--config", str(config), "--faults", str(faults)]) == 2
    assert capsys.readouterr().err == (
        'ramstroke: the fault script has interface_down, which only can.interface = "virtual" can play, not '
        '"udp_multicast": delete it from the script and set the interface down by hand\n'
    )
    assert not (tmp_path / "imu").exists()


def test_a_good_script_is_what_it_says(tmp_path: Path) -> None:
    path = tmp_path / "good.toml"
    path.write_text(
        f'seed = 9\n{HEAD}"jump"\nat_s = 3\nfor_s = 0.5\noffset_mm = -40\n{HEAD}"flood"\nat_s = 1.5\nfor_s = 2\n'
    )
    script = load_faults(path)
    jump, flood = Jump(at_s=3, for_s=0.5, offset_mm=-40), Flood(at_s=1.5, for_s=2)
    assert script == FaultScript(seed=9, fault=(jump, flood))
    assert script.in_order == [flood, jump]
    path.write_text("")
    assert load_faults(path) == FaultScript(seed=1, fault=())


def test_our_scripts_show_a_bit_of_everything() -> None:
    wet, long = (load_faults(SCRIPTS / f"{name}.toml") for name in ("wet_cable", "long"))
    assert max(fault.at_s + fault.for_s for fault in wet.fault) <= 60
    assert len({fault.kind for fault in wet.fault}) >= 12
    assert 1500 < max(fault.at_s + fault.for_s for fault in long.fault) <= 1800
    others = {kind for kind in KINDS if kind.startswith(("serial_", "jy901_", "adapter_", "interface_"))}
    assert {fault.kind for fault in long.fault} == set(KINDS) - others
    for script in (wet, long):
        assert list(script.fault) == script.in_order


def test_the_page_in_the_repository_is_what_the_models_say() -> None:
    page = (HOUSE / "docs" / "faults.md").read_text(encoding="utf-8")
    assert page == generate(), "run: python -m daemon.simulation.fault_reference > docs/faults.md"
    for name, kind in KINDS.items():
        (row,) = [line for line in page.splitlines() if line.startswith(f"| `{name}` |")]
        for key in set(kind.model_fields) - set(Fault.model_fields) - {"kind"}:
            assert f"`{key}` (" in row
    assert len(KINDS) == 40
