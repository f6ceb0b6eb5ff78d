"""docs/log-format.md names every channel, field, metadata record and attachment of a real log."""

import re
from fnmatch import fnmatchcase
from typing import Any

import pytest
from mcap.reader import make_reader
from places import ROOT

import pcpc
from pcpc.executive.log.schemas import EVENTS, FRAME_SCHEMA

PAGE = (ROOT / "docs" / "log-format.md").read_text("utf-8")


def table(title: str) -> list[list[str]]:
    """Return the rows of the table of a chapter, without its head."""
    chapter = PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (.*) \|$", chapter, re.MULTILINE)
    return [[cell.strip() for cell in row.split(" | ")] for row in rows if "`" in row]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("log")
    pcpc.simulate("probe", set={"duration_s": 0.05}, folder=folder)
    with (folder / "log.mcap").open("rb") as file:
        reader = make_reader(file)
        names = {
            "metadata": {found.name for found in reader.iter_metadata()},
            "attachments": {found.name for found in reader.iter_attachments()},
        }
        return reader.get_summary(), names


def test_the_channels_are_those_of_the_page(log: Any) -> None:
    summary, _ = log
    found = {
        (channel.topic, channel.message_encoding, summary.schemas[channel.schema_id].name)
        for channel in summary.channels.values()
    }
    told = {
        (topic.strip("`"), encoding, schema) for topic, encoding, schema, _ in table("Channels")
    }
    assert {one for one in found if not one[0].startswith("/plant")} == told
    plant = {(f"/plant{topic}", encoding) for topic, encoding, _ in told}
    assert {one[:2] for one in found if one[0].startswith("/plant")} == plant
    assert ("/plant/state", "cdr", "pcpc/PlantState") in found


def test_the_fields_of_a_frame_are_those_of_the_page() -> None:
    fields = re.findall(r"^(\w+(?:\[8\])?) (\w+)", FRAME_SCHEMA, re.MULTILINE)
    assert [(row[1], row[0].strip("`")) for row in table("Messages")] == fields


def test_every_kind_of_event_is_told() -> None:
    missing = [
        kind for kind in (*EVENTS.values(), "change", "not finite") if f"`{kind}`" not in PAGE
    ]
    assert not missing, missing


@pytest.mark.parametrize("what", ["metadata", "attachments"])
def test_everything_beside_the_messages_is_told(log: Any, what: str) -> None:
    _, names = log
    told = [form for row in table(what.title()) for form in re.findall("`([^`]+)`", row[0])]
    forms = [form.replace("TOPIC", "*") for form in told]
    missing = [name for name in names[what] if not any(fnmatchcase(name, one) for one in forms)]
    assert len(names[what]) > 4 and not missing, missing
