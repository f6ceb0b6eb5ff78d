"""The tools' schemas are those of the commands' requests, and of the structs that they print."""

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from pcpc.tools.run.mcp import tools

SCHEMAS = Path(__file__).parents[3] / "docs/reference/schemas"
PRINTED = {  # by tool: the files of docs/reference/schemas
    "rigs": ["rigs"], "check": ["check"], "simulate": ["run"], "run": ["run"], "branch": ["run"],
    "set": ["set"], "report": ["report"], "replay": ["replay"], "compare": ["compare"],
    "operate": ["operate-arm", "operate-handover", "operate-hold", "operate-lock"],
}  # fmt: skip


def keys_in(schema: Any) -> set[str]:
    """Return the names of all properties in a schema."""
    parts = schema.values() if isinstance(schema, dict) else schema
    found = {*schema.get("properties", ())} if isinstance(schema, dict) else set[str]()
    inner = (keys_in(one) for one in parts if isinstance(one, dict | list))
    return found.union(*inner)


@pytest.mark.parametrize("tool", PRINTED)
def test_what_a_tool_answers_is_what_its_command_prints(tool: str) -> None:
    files = [json.loads((SCHEMAS / f"{name}.json").read_text()) for name in PRINTED[tool]]
    told = tools.described(tool)[2]
    known = {*tools.described("log")[2]["properties"]}
    assert keys_in(told) - known == keys_in(files) - known
    jsonschema.Draft202012Validator.check_schema(told)


@pytest.mark.parametrize("tool", tools.TOOLS)
def test_an_answer_of_another_type_is_not_what_was_declared(tool: str) -> None:
    told = tools.described(tool)[2]
    jsonschema.validate({"exit": 0, "audit": "1:0"}, told)
    for wrong in ({"exit": "0", "audit": "1:0"}, {"exit": 0}, {"audit": "1:0", "said": "x"}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(wrong, told)
    if tools.TOOLS[tool].answer:
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({"audit": "1:0", "answer": 5}, told)


def test_stop_is_a_verb_that_is_a_command_of_its_own() -> None:
    assert tools.words("operate", {"verb": "stop", "run": "hull"})[:2] == ["stop", "hull"]
    assert tools.words("operate", {"verb": "hold"})[:2] == ["operate", "hold"]
