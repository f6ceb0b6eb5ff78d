"""The JSON Schema of a rig file: right rigs are valid, wrong ones where a schema can know it."""

import io
import json
from collections.abc import Iterator
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft7Validator
from places import ROOT
from small_rig import RIG, Case
from wrong_rigs import BLOCKS, SCHEMA, UNKNOWN

from pcpc.executive.errors import RigError
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.reading import load_rig
from pcpc.tools import cli
from pcpc.tools.make import new
from pcpc.tools.run.rig_schema import rig_schema

MOTOR = new.TEMPLATE / "rig.yaml"
RIGS = sorted(
    file
    for pattern in ("plants/*/rig.yaml", "plants/*/rigs/*.yaml", "tests/rigs/**/*.yaml",
                    "tests/drivers/*/*.yaml", "tools/make/template/**/*.yaml")
    for file in ROOT.glob(pattern)
)  # fmt: skip
NAMES = {  # what is wrong in the motor's rig, and the key at which its own schema says so
    "controller: pid\n": ("controller: pidd\n", "controller"),
    "kp_V_rad: 30.0": ("kp_rad: 30.0", "kp_rad"),
    "weight: 0.0\n": ("weight: -7.0\n", "weight"),
    "encoder_rad: rx.FB.encoder": ("encoder_rad: rx.FB.current", "encoder_rad"),
    "q_d_rad: reference": ("q_rad: reference", "q_rad"),
    "{voltage_V: rx.CMD.voltage}": ("{voltage_V: rx.CMD.mode}", "voltage_V"),
    "CMD.voltage: controller": ("CMD.volt: controller", "CMD.volt"),
    "CMD.voltage: {low": ("CMD.volts: {low", "CMD.volts"),
    "FB.encoder: motor.encoder_rad": ("FB.encoder: motor.encoder", "FB.encoder"),
    "safe: {CMD.voltage": ("safe: {FB.encoder", "FB.encoder"),
    "overshoot_mrad:": ("overshot_mrad:", "overshot_mrad"),
    "\n  pd:\n    rest": ("\n  pdd:\n    rest", "pdd"),
    "controllers: [pid]": ("controllers: [pi]", "controllers"),
    "counts_per_turn: 2000.0": ("counts_per_turn: 0.0", "counts_per_turn"),
    "watch: ": ("losses: {FBB: {share: 0.1}}\nwatch: ", "FBB"),
}


@cache
def any_rig() -> Draft7Validator:
    schema = rig_schema()
    Draft7Validator.check_schema(schema)
    return Draft7Validator(schema)


@cache
def motors() -> Draft7Validator:
    with redirect_stdout(io.StringIO()) as told:
        assert cli.main(["check", str(MOTOR), "--schema"]) == 0
    return Draft7Validator(json.loads(told.getvalue()))


def own_data(path: Path, text: str | None = None) -> Any:
    """Return what a file says itself, without its base."""
    return yamlfile._parse(path.resolve(), path.read_text("utf-8") if text is None else text)


def paths(error: Any) -> Iterator[str]:
    """Yield the paths and messages of an error and of all below it."""
    yield f"{[*error.absolute_path]} {error.message}"
    for below in error.context:
        yield from paths(below)


@pytest.mark.parametrize("file", RIGS, ids=lambda file: "-".join(file.parts[-3:]))
def test_every_rig_is_valid(file: Path) -> None:
    wrong = [*any_rig().iter_errors(own_data(file))]
    assert not wrong, "\n".join(paths(wrong[0]))


@pytest.mark.parametrize("case", [*SCHEMA, *BLOCKS[-3:-1]], ids=lambda case: case.new)
def test_a_wrong_rig_is_invalid_where_a_schema_can_know_it(case: Case) -> None:
    try:
        wrong = own_data(MOTOR, RIG.replace(case.old, case.new, 1))
    except RigError:
        return  # no YAML of ours
    known = case.new not in UNKNOWN and case not in BLOCKS
    assert any_rig().is_valid(wrong) != known, case


def test_a_rig_knows_its_own_names() -> None:
    text = MOTOR.read_text("utf-8")
    assert not [*motors().iter_errors(own_data(MOTOR))]
    for old, (new_text, at) in NAMES.items():
        assert text.count(old) == 1, old
        wrong = [*motors().iter_errors(own_data(MOTOR, text.replace(old, new_text)))]
        assert wrong and any(at in told for one in wrong for told in paths(one)), old


def test_without_a_base_all_that_is_needed_has_to_be_there() -> None:
    text = MOTOR.read_text("utf-8")
    for line in ("rate_hz: 1000.0\n", "  node: EXEC\n", "    law: laws/pid.py:BLOCK\n"):
        cut = own_data(MOTOR, text.replace(line, "", 1))
        assert not motors().is_valid(cut) and any_rig().is_valid(cut), line


@pytest.mark.deep
@pytest.mark.parametrize(
    "file", sorted(ROOT.glob("plants/*/rigs/*.yaml")), ids=lambda file: file.stem
)
def test_every_rig_is_valid_with_its_names(file: Path) -> None:
    rig = load_rig(file)
    schema = rig_schema(rig, [plan(rig, role, rig.config.pacing) for role in rig.roles])
    del schema["properties"]["expect"]  # metrics were not given
    schema["additionalProperties"] = True
    wrong = [*Draft7Validator(schema).iter_errors(own_data(file))]
    assert not wrong, "\n".join(paths(wrong[0]))


def test_every_key_has_its_words() -> None:
    schema = rig_schema()
    silent = [
        f"{name}.{key}"
        for name, struct in {"": schema, **schema["$defs"]}.items()
        for key, own in struct.get("properties", {}).items()
        if not own.get("description") and "$ref" not in str(own)
    ]
    assert not silent, silent


def test_a_new_rig_has_the_schema_beside_it(tmp_path: Path) -> None:
    new.write(tmp_path / "own", drive="mit")
    for file in ("rig.yaml", "drive.yaml"):
        first, _ = (tmp_path / "own" / file).read_text("utf-8").split("\n", 1)
        assert first == f"# yaml-language-server: $schema={new.SCHEMA}"
    written = json.loads((tmp_path / "own" / new.SCHEMA).read_text("utf-8"))
    assert written == json.loads(json.dumps(rig_schema()))
