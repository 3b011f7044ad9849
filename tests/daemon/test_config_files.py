"""The configuration files that come with the program can be used, and say the truth about the defaults."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from daemon.cli import main
from daemon.configuration import load
from daemon.configuration_reference import nested_model, sections
from daemon.settings import Settings

FOLDER = Path(__file__).parents[2] / "config"
FILES = ("ramstroke.toml", "trial.toml", "trial_service.toml", "bench.toml")
# A default that is commented out begins with "#key" or "#[section]"; prose begins with "# ".
_COMMENTED = re.compile(r"^#(?=[\w\[])", re.M)


@pytest.mark.parametrize("name", FILES)
def test_check_config_accepts_the_file(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check-config", str(FOLDER / name)]) == 0
    assert capsys.readouterr().out.endswith("good\n")


def test_the_file_for_a_real_support_changes_no_default() -> None:
    assert load(FOLDER / "ramstroke.toml") == Settings()


@pytest.mark.parametrize(
    ("section", "model"),
    [(section, model) for section, model in sections(Settings) if section != "can.reference"],
    ids=lambda value: str(value),
)
def test_every_key_stands_there_with_its_default_or_an_example(section: str, model: type[BaseModel]) -> None:
    table = _with_comments_taken_away()
    for part in section.split("."):
        table = table[part]
    keys = {key: field for key, field in model.model_fields.items() if nested_model(field.annotation) is None}
    assert {key for key, value in table.items() if not isinstance(value, dict)} == set(keys)
    # In JSON's terms, so that a path equals its text.
    defaults = {
        key: value for key, value in model().model_dump(mode="json").items() if key in keys and value is not None
    }
    assert {key: table[key] for key in defaults} == defaults


def test_an_example_of_a_key_without_default_has_the_right_type() -> None:
    tree = _with_comments_taken_away()
    displacement = tree["can"]["displacement"]
    own_dbc = {key: displacement[key] for key in displacement if key not in ("preset", "node_id")}
    canopen = {"preset": "cia406", "node_id": displacement["node_id"]}
    for variant in (own_dbc, canopen):
        Settings.model_validate(tree | {"can": tree["can"] | {"displacement": variant}})


def test_nothing_in_it_is_commented_out_twice_or_lost_between_prose_and_keys() -> None:
    text = (FOLDER / "ramstroke.toml").read_text(encoding="utf-8")
    keys = re.findall(r"^#?([a-z_]+) = ", text, re.M)
    wanted = sum(
        nested_model(field.annotation) is None
        for section, model in sections(Settings)
        if section != "can.reference"
        for field in model.model_fields.values()
    )
    assert len(keys) == wanted + 2  # message and signal of [can.reference]


def test_trial_joins_sim_and_run_over_a_socket_and_multicast_and_publishes() -> None:
    settings = load(FOLDER / "trial.toml")
    assert (settings.imu.transport, settings.can.interface) == ("socket", "udp_multicast")
    assert settings.can.channel == "239.74.163.2"
    assert settings.can.publish.enabled
    assert not settings.can.listen_only
    assert settings.can.reference is not None
    _writes_only_below(settings, Path("/tmp/ramstroke-trial"))
    assert Path(settings.imu.socket_path).parent == Path("/tmp/ramstroke-trial")


def test_the_trial_of_the_service_keeps_away_from_what_the_real_support_taught() -> None:
    settings, real = load(FOLDER / "trial_service.toml"), Settings()
    assert (settings.imu.transport, settings.can.interface, settings.can.channel) == ("socket", "socketcan", "vcan0")
    assert settings.can.publish.enabled
    assert settings.service.socket == real.service.socket  # `ramstroke status` finds it
    for ours, theirs in (
        (settings.recording.directory, real.recording.directory),
        (settings.service.state_file, real.service.state_file),
    ):
        assert ours.is_relative_to("/var/lib/ramstroke/trial")
        assert not theirs.is_relative_to("/var/lib/ramstroke/trial")


def test_bench_is_virtual_throughout() -> None:
    settings = load(FOLDER / "bench.toml")
    assert (settings.imu.transport, settings.can.interface) == ("virtual", "virtual")
    _writes_only_below(settings, Path("/tmp/ramstroke-bench"))


def _writes_only_below(settings: Settings, folder: Path) -> None:
    assert settings.recording.directory == folder / "recordings"
    assert settings.service.socket.parent == settings.service.state_file.parent == folder


def _with_comments_taken_away() -> dict[str, Any]:
    text = (FOLDER / "ramstroke.toml").read_text(encoding="utf-8")
    return tomllib.loads(_COMMENTED.sub("", text))
