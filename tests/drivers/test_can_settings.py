from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from drivers.can.settings import CanSettings, DisplacementSettings, PublishSettings


def test_defaults_listen_only_on_can0_to_the_support_controller() -> None:
    settings = CanSettings()
    assert (settings.interface, settings.channel, settings.listen_only) == ("socketcan", "can0", True)
    assert settings.displacement.preset == "support_controller"
    assert settings.displacement.latency_ms == 17.5
    assert settings.reference is None
    assert not settings.publish.enabled


def test_own_dbc_file_replaces_the_default_preset() -> None:
    settings = DisplacementSettings(dbc=Path("a.dbc"), message="M", signal="s")
    assert settings.preset is None


@pytest.mark.parametrize(
    ("model", "values", "sentence"),
    [
        (CanSettings, {"publish": {"enabled": True}}, "set `listen_only = false` or disable publishing"),
        (CanSettings, {"interface": "udp_multicast"}, '"can0" is no multicast address'),
        (CanSettings, {"interface": "udp_multicast", "channel": "10.0.0.1"}, "is no multicast address"),
        (CanSettings, {"bitrate": 500_000}, "bitrate"),
        (CanSettings, {"channel": ""}, "channel"),
        (PublishSettings, {"arbitration_id": 0x800}, "0x800 needs more than 11 bits: set `extended = true`"),
        (PublishSettings, {"period_ms": 1}, "period_ms"),
        (
            DisplacementSettings,
            {"preset": "cia406", "dbc": "a.dbc"},
            "`preset` and `dbc` exclude each other",
        ),
        (DisplacementSettings, {"dbc": "a.dbc", "message": "M"}, "`dbc`, `message` and `signal` are needed"),
        (DisplacementSettings, {"preset": None}, "`dbc`, `message` and `signal` are needed"),
        (DisplacementSettings, {"node_id": 5}, "`node_id` belongs to CANopen"),
        (DisplacementSettings, {"valid_value": 0}, "`valid_value` needs `valid_signal`"),
        (DisplacementSettings, {"checksum": "sum8"}, "`checksum_signal` and `checksum` belong together"),
        (DisplacementSettings, {"checksum_signal": "crc"}, "`checksum_signal` and `checksum` belong together"),
        (DisplacementSettings, {"checksum_signal": "crc", "checksum": "crc32"}, "crc8_autosar"),
        (DisplacementSettings, {"minimum_mm": 5, "maximum_mm": 5}, "`minimum_mm` must be smaller"),
        (DisplacementSettings, {"maximum_mm": float("nan")}, "finite"),
        (DisplacementSettings, {"unit": "inch"}, "unit"),
        (DisplacementSettings, {"preset": "marco"}, "support_controller"),
        (DisplacementSettings, {"timeout_ms": 0}, "timeout_ms"),
    ],
)
def test_settings_that_cannot_work_are_refused_with_a_reason(
    model: type[BaseModel], values: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(ValidationError) as refusal:
        model.model_validate(values)
    assert sentence in str(refusal.value)


def test_publishing_is_allowed_once_listen_only_is_off() -> None:
    settings = CanSettings.model_validate({"listen_only": False, "publish": {"enabled": True}})
    assert settings.publish.enabled


def test_multicast_addresses_of_both_kinds_are_accepted() -> None:
    for address in ("239.74.163.2", "ff15::1"):
        assert CanSettings(interface="udp_multicast", channel=address).channel == address


@pytest.mark.parametrize("model", [CanSettings, DisplacementSettings, PublishSettings])
def test_every_option_has_a_description_for_the_configuration_reference(model: type[BaseModel]) -> None:
    assert [name for name, field in model.model_fields.items() if not field.description] == []
