"""The live page as a service of its own, beside the daemon."""

from __future__ import annotations

import asyncio
import json
import urllib.request
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from tests.acceptance.machine.guest.documented import documented
from tests.acceptance.machine.guest.kit import (
    PATIENCE_S,
    RECORDINGS,
    RESULTS,
    in_the_sandbox_of,
    properties,
    run,
    set_up,
    start_service,
    status,
    wait_for,
)

ADDRESS = "http://127.0.0.1:8448"
ALLOWED = ("temporary folder", "recordings", "numpy", "unix socket", "internet socket", "internet 6 socket")


@pytest.fixture(scope="module", autouse=True)
def computer() -> None:
    """The service runs."""
    set_up()
    start_service()
    wait_for("samples", lambda: status().get("estimator", {}).get("samples", 0) > 20)


def view(*names: str) -> dict[str, str]:
    return properties(*names, unit="ramstroke-view")


def page(path: str) -> bytes:
    with urllib.request.urlopen(ADDRESS + path, timeout=PATIENCE_S) as answer:
        content: bytes = answer.read()
        return content


def is_served() -> bool:
    try:
        return b"<main>" in page("/")
    except OSError:
        return False


def heard(*wanted: dict[str, Any]) -> list[dict[str, Any]]:
    """What a browser hears until each of these has come, in any order."""

    async def listen() -> list[dict[str, Any]]:
        told: list[dict[str, Any]] = []
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{ADDRESS}/live") as channel:
            while not all(any(one.items() <= message.items() for message in told) for one in wanted):
                told.append(await channel.receive_json())
        return told

    return asyncio.run(asyncio.wait_for(listen(), PATIENCE_S))


def test_it_is_installed_beside_the_daemon_and_not_enabled() -> None:
    assert view("UnitFileState", "ActiveState") == {"UnitFileState": "disabled", "ActiveState": "inactive"}
    documented("sudo systemctl enable --now ramstroke-view")
    wait_for("the page", is_served)


def test_nobody_but_this_computer_is_served_and_it_is_nobodys_user() -> None:
    listening = [line.split()[3] for line in run("ss", "--tcp", "--listening", "--numeric", "--no-header").splitlines()]
    assert [address for address in listening if address.endswith(":8448")] == ["127.0.0.1:8448"]
    users = Path(f"/proc/{view('MainPID')['MainPID']}/status").read_text()
    uid = int(next(line for line in users.splitlines() if line.startswith("Uid:")).split()[1])
    assert 61184 <= uid <= 65519  # of DynamicUser


def test_a_browser_hears_the_daemon() -> None:
    snapshot = heard({"type": "snapshot"}, {"type": "status"}, {"type": "estimate"})[0]
    assert snapshot["link"]["state"] == "up"
    assert snapshot["hello"]["version"] == status()["version"]
    assert snapshot["status"]["imu"]["state"] == status()["imu"]["state"]


def test_recordings_are_listed_and_given_away() -> None:
    listed = json.loads(page("/recordings"))["recordings"]
    names = [row["name"] for row in listed]
    assert set(names) == {path.name for path in RECORDINGS.glob("*.mcap")}
    assert page(f"/recordings/{names[0]}").startswith(b"\x89MCAP0\r\n")


def test_a_report_without_its_packages_says_what_to_install() -> None:
    name = json.loads(page("/recordings"))["recordings"][0]["name"]
    asked = urllib.request.Request(f"{ADDRESS}/recordings/{name}/report", b"", {"Origin": ADDRESS}, method="POST")
    with urllib.request.urlopen(asked, timeout=PATIENCE_S) as answer:
        assert answer.status == 202

    def failure() -> str:
        (snapshot,) = heard({"type": "snapshot"})[:1]
        told = snapshot["reports"]["reports"].get(name, {})
        return str(told.get("why")) if told.get("state") == "failed" else ""

    assert "a report needs plotly" in wait_for("the report's failure", failure)


def test_the_end_of_the_daemon_is_told_and_it_is_found_again() -> None:
    run("systemctl", "stop", "ramstroke")
    assert heard({"type": "snapshot"})[0]["link"]["state"] == "down"
    start_service()
    heard({"type": "link", "state": "up"}, {"type": "estimate"})


def test_the_sandbox_holds_and_lets_the_page_work() -> None:
    found = in_the_sandbox_of("ramstroke-view")
    assert {name: found[name] for name in ALLOWED} == dict.fromkeys(ALLOWED, "yes")
    assert [name for name, said in found.items() if said == "yes" and name not in ALLOWED] == []
    assert "somebody-elses" not in found["seen temporary files"]


def test_exposure_by_systemds_own_measure() -> None:
    said = run("systemd-analyze", "security", "--threshold=15", "ramstroke-view.service")
    (RESULTS / "security.txt").write_text(said)


def test_it_ends_as_asked() -> None:
    run("systemctl", "stop", "ramstroke-view")
    assert view("ActiveState", "Result") == {"ActiveState": "inactive", "Result": "success"}
