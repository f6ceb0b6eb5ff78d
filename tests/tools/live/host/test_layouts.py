"""The layouts for Foxglove and Lichtblick show what a log holds."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from logcommand import barrel_log
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from places import ROOT

from pcpc.executive.log import reader as logs
from pcpc.executive.log.schemas import field_names

LAYOUTS = sorted((ROOT / "plants").glob("*/foxglove.json"))
KEYS = {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}


def panels(tree: Any) -> Iterator[str]:
    """Yield the panels of a mosaic."""
    if isinstance(tree, str):
        yield tree
        return
    assert tree["direction"] in ("row", "column") and 0 < tree["splitPercentage"] < 100, tree
    yield from panels(tree["first"])
    yield from panels(tree["second"])


def message_paths(layout: dict[str, Any]) -> Iterator[str]:
    """Yield the message paths of all panels."""
    for panel in layout["configById"].values():
        yield from (path["value"] for path in panel.get("paths", ()))
        if "topicPath" in panel:
            yield panel["topicPath"]


def fields_by_topic(path: Path) -> dict[str, list[str]]:
    """Return the fields of each topic as the schemas in the file give them."""
    found = {}
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        text = schema.data.decode()
        found[channel.topic] = (
            list(json.loads(text)["properties"])
            if schema.encoding == "jsonschema"
            else re.findall(r"^\S+ (\w+)", text, re.MULTILINE)
        )
    return found


@pytest.mark.parametrize("path", LAYOUTS, ids=lambda path: path.name)
def test_every_message_path_of_a_layout_is_in_a_fresh_log(path: Path) -> None:
    fields = fields_by_topic(barrel_log())
    used = list(message_paths(json.loads(path.read_text())))
    assert len(used) > 10, used
    for entry in used:
        topic, _, field = entry.partition(".")
        assert topic in fields, f"{entry}: no such topic; {sorted(fields)}"
        assert not field or field in fields[topic], f"{entry}: not in {fields[topic]}"


@pytest.mark.parametrize("path", LAYOUTS, ids=lambda path: path.name)
def test_a_layout_is_one_that_both_programs_read(path: Path) -> None:
    layout = json.loads(path.read_text())
    assert set(layout) == KEYS, set(layout) ^ KEYS
    placed = sorted(panels(layout["layout"]))
    assert placed == sorted(layout["configById"]), "a panel without place or a place without panel"
    kinds = {name.partition("!")[0] for name in placed}
    assert kinds <= {"Plot", "StateTransitions", "Table", "RawMessages"}, kinds
    for name, panel in layout["configById"].items():
        assert all({"value", "timestampMethod"} <= set(p) for p in panel.get("paths", ())), name


def test_there_is_a_layout() -> None:
    assert LAYOUTS


def test_schema_fields_are_the_names_that_the_recorder_gives() -> None:
    fields, log = fields_by_topic(barrel_log()), logs.read(barrel_log())
    for name, node in log.node.items():
        for kind, columns in (("state", node.columns), ("timing", node.timing)):
            topic = logs.topic(name, kind)
            assert fields[topic] == field_names(list(columns)), topic


def test_mcap_ros2_decodes_every_message_of_every_cdr_channel() -> None:
    log, count = logs.read(barrel_log()), dict[str, int]()
    with barrel_log().open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        topics = {c.topic: i for i, c in summary.channels.items() if c.message_encoding == "cdr"}
        written = summary.statistics.channel_message_counts
    with barrel_log().open("rb") as file:
        decoding = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, raw, message in decoding.iter_decoded_messages(list(topics)):
            count[channel.topic] = count.get(channel.topic, 0) + 1
            if channel.topic == "/state" and raw.sequence == 200:
                row = log.node["executive"].cycle.tolist().index(200)
                value = log.node["executive"].columns["controller.e_rad"][row]
                assert message.controller_e_rad == value, f"{message.controller_e_rad} {value}"
    assert count == {topic: written[i] for topic, i in topics.items()}, count
    assert len(count) == 6, sorted(count)
