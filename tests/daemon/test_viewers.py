"""Recordings in the viewers that people have: read by two other projects' readers, shown by the shipped layouts."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from foxglove import layouts
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from daemon.recording import schemas, topics
from daemon.recording.cdr import Layout, fields
from daemon.recording.topics import TOPICS
from daemon.recording.writer import RecordingWriter
from daemon.view.foxglove.channels import LOG_TOPIC, SCHEMAS
from tests.conftest import DemoRun
from tests.daemon.recording_kit import ATTACHMENTS, METADATA, ONE_OF_EACH

VIEWERS = Path(__file__).resolve().parents[2] / "config" / "viewers"
PLOTTABLE = {"bool", "uint8", "int16", "uint16", "int32", "uint32", "int64", "float64"}
CONFIGS: dict[str, Any] = {
    "Plot": layouts.PlotConfig,
    "StateTransitions": layouts.StateTransitionsConfig,
    "RosOut": layouts.LogConfig,
    "Table": layouts.TableConfig,
    "RawMessages": layouts.RawMessagesConfig,
}


@pytest.fixture(scope="module")
def all_kinds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("kinds") / "all.mcap"
    with RecordingWriter(path, METADATA, ATTACHMENTS) as writer:
        for _ in range(3):
            for topic, record in ONE_OF_EACH.items():
                writer.write(topic, record)
    return path


def same(left: list[Any], right: list[Any]) -> bool:
    return len(left) == len(right) and all(
        one == other or (isinstance(one, float) and math.isnan(one) and math.isnan(other))
        for one, other in zip(left, right, strict=True)
    )


def by_rosbags(path: Path) -> Iterator[tuple[str, int, list[Any]]]:
    with AnyReader([path]) as reader:
        for connection, t_ns, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            names = [name for name, _ in reader.typestore.fielddefs[connection.msgtype][1]]
            found: list[Any] = []
            for name in names:
                value = getattr(message, name)
                found += [value.sec, value.nanosec] if hasattr(value, "sec") else [_plain(value)]
            yield connection.topic, t_ns, found


def _plain(value: Any) -> Any:
    return value.tobytes() if hasattr(value, "tobytes") else value


def by_mcap_ros2(path: Path) -> Iterator[tuple[str, int, list[Any]]]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for item in reader.iter_decoded_messages():
            assert item.schema is not None
            found: list[Any] = []
            for _, name, *_ in fields(item.schema.data.decode()):
                value = getattr(item.decoded_message, name)
                if hasattr(value, "sec"):
                    found += [value.sec, value.nanosec]
                else:
                    found.append(bytes(value) if isinstance(value, list | tuple) else value)
            yield item.channel.topic, item.message.log_time, found


def by_us(path: Path) -> Iterator[tuple[str, int, list[Any]]]:
    """Our own decoding, of the file as another project's reader orders it: by time."""
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            layout = TOPICS[channel.topic].layout
            yield channel.topic, message.log_time, list(layout.unpack(message.data))


@pytest.mark.parametrize("read", [by_rosbags, by_mcap_ros2])
def test_other_readers_decode_every_kind_of_record_as_we_do(read: Any, all_kinds: Path) -> None:
    ours = sorted(by_us(all_kinds), key=lambda item: item[:2])
    theirs = sorted(read(all_kinds), key=lambda item: item[:2])
    assert {topic for topic, _, _ in theirs} == set(TOPICS)
    assert len(theirs) == 3 * len(TOPICS)
    for mine, other in zip(ours, theirs, strict=True):
        assert mine[:2] == other[:2]
        assert same(mine[2], other[2]), f"{mine[0]}: {mine[2]} is not {other[2]}"


@pytest.mark.parametrize("read", [by_rosbags, by_mcap_ros2])
def test_other_readers_decode_a_whole_recording_as_we_do(read: Any, demo_run: DemoRun) -> None:
    count = 0
    for (topic, t_ns, mine), other in zip(by_us(demo_run.recording), read(demo_run.recording), strict=True):
        count += 1
        assert (topic, t_ns) == other[:2]
        assert same(mine, other[2])
    assert count > 80_000


def test_the_log_is_the_standard_message_byte_for_byte() -> None:
    for store in (Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY):
        known = get_typestore(store)
        constants, standard = known.fielddefs["rcl_interfaces/msg/Log"]
        names = [name for name, _ in standard]
        assert names == [name for _, name, *_ in fields(schemas.LOG.text)]
        for name, _, value in constants:
            assert f"uint8 {name}={value}\n" in schemas.LOG.text
        raw = TOPICS[topics.LOG].encode(ONE_OF_EACH[topics.LOG])
        line: Any = known.deserialize_cdr(raw, "rcl_interfaces/msg/Log")
        assert (line.stamp.sec, line.stamp.nanosec, line.level) == (1234, 567_890_123, 30)
        assert (line.name, line.msg, line.line) == ("drivers.can", "bus off; 15 °C", 0)
        assert bytes(known.serialize_cdr(line, "rcl_interfaces/msg/Log")) == raw
        stamp_names = [name for name, _ in known.fielddefs["builtin_interfaces/msg/Time"][1]]
        stamp_text = schemas.LOG.text.partition("MSG: builtin_interfaces/Time\n")[2]
        assert stamp_names == [name for _, name, *_ in fields(stamp_text)] == ["sec", "nanosec"]


def enumerated(layout: Layout) -> dict[str, dict[str, str]]:
    """Which names a viewer shows for the values of a field: of the constants right before it, of its own type."""
    found: dict[str, dict[str, str]] = {}
    waiting: dict[str, str] = {}
    kind_of_waiting = None
    for text in layout.text.partition("===")[0].splitlines():
        words = text.partition("#")[0].split()
        if not words:
            continue
        kind, rest = words[0], "".join(words[1:])
        if kind != kind_of_waiting:
            waiting, kind_of_waiting = {}, kind
        if "=" in rest:
            name, _, value = rest.partition("=")
            assert value not in waiting, f"{layout.name}: two names for {value}"
            waiting[value] = name
        elif waiting:
            found[rest], waiting = waiting, {}
    return found


def test_viewers_show_names_for_every_enumeration() -> None:
    assert enumerated(schemas.ESTIMATE)["segment"] == {"0": "SEGMENT_ZUPT", "1": "SEGMENT_VVS", "2": "SEGMENT_CVS"}
    assert enumerated(schemas.MOVE)["kind"] == {"0": "MOVEKIND_PUSH", "1": "MOVEKIND_RETRACT"}
    for row in TOPICS.values():
        named = enumerated(row.layout)
        bytes_of_it = {name for kind, name, *_ in fields(row.layout.text) if kind == "uint8"}
        if row.name != topics.LOG:  # the standard has them at its head
            assert set(named) == bytes_of_it, row.name


def json_type(topic: str, path: list[str]) -> str:
    """The type of a field of a live channel."""
    schema = SCHEMAS[topic]
    for name in path:
        schema = schema["properties"][name]
    return str(schema["type"])


def ros_type(topic: str, path: list[str]) -> str:
    (name,) = path
    return {field: kind for kind, field, *_ in fields(TOPICS[topic].layout.text)}[name]


def leaves(tree: Any) -> list[str]:
    return [tree] if isinstance(tree, str) else leaves(tree["first"]) + leaves(tree["second"])


@pytest.mark.parametrize(("name", "log"), [("foxglove_recording.json", topics.LOG), ("foxglove_live.json", LOG_TOPIC)])
def test_a_layout_names_only_what_there_is(name: str, log: str) -> None:
    layout = json.loads((VIEWERS / name).read_text())
    panels: dict[str, dict[str, Any]] = layout["configById"]
    assert sorted(leaves(layout["layout"])) == sorted(panels)
    live = name == "foxglove_live.json"
    seen: set[str] = set()
    for panel, config in panels.items():
        kind = panel.partition("!")[0]
        # The settings that the viewer's maker documents, and the two ways to give a panel its title.
        known = set(CONFIGS[kind]()._to_dict()) | {"title", "foxglovePanelTitle"}
        if kind == "Plot":
            known |= {"showPlotValuesInLegend"}
        assert set(config) <= known, panel
        if kind == "RosOut":
            assert config["topicToRender"] == log
            continue
        if "topicPath" in config:
            assert config["topicPath"] in (SCHEMAS if live else TOPICS)
            continue
        for series in config["paths"]:
            topic, *path = series["value"].split(".")
            seen.add(series["value"])
            if live:
                wanted = {"number", "integer"} if kind == "Plot" else {"string", "integer"}
                assert json_type(topic, path) in wanted, series["value"]
            else:
                wanted = PLOTTABLE if kind == "Plot" else {"uint8", "bool", "string"}
                assert ros_type(topic, path) in wanted, series["value"]
    if not live:
        assert {f"/estimate/{tier}.displacement" for tier in ("provisional", "settled")} <= seen
        assert {"/displacement/observed.value", "/displacement/reference.value"} <= seen
        assert {f"/estimate/provisional.chart_{limit}" for limit in ("lower", "upper")} <= seen


def test_the_layout_of_plotjuggler_names_only_what_there_is() -> None:
    root = ET.parse(VIEWERS / "plotjuggler_recording.xml").getroot()
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    assert len(curves) > 8
    for curve in curves:
        topic, _, name = curve.rpartition("/")
        assert ros_type(topic, [name]) in PLOTTABLE, curve
    (splitter,) = root.iter("DockSplitter")
    sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
    assert len(sizes) == int(splitter.attrib["count"]) == len(list(splitter.iter("DockArea")))
    assert math.isclose(sum(sizes), 1.0)


def test_rosbags_knows_each_field_by_the_type_of_the_schema(all_kinds: Path) -> None:
    with AnyReader([all_kinds]) as reader:
        for connection in reader.connections:
            definitions = reader.typestore.fielddefs[connection.msgtype][1]
            told = {name: spec[1][0] if spec[0] is Nodetype.BASE else spec[0] for name, spec in definitions}
            for kind, name, *_ in fields(TOPICS[connection.topic].layout.text):
                expected = {"builtin_interfaces/Time": Nodetype.NAME, "uint8[]": Nodetype.SEQUENCE}.get(kind, kind)
                assert told[name] == expected
