"""docs/reference/schemas: what commands print with --json, held against real output.

Each command with --json has a schema there; a new one without fails. Those about running nodes,
logs, and rigs and machines: test_schemas_live.py, test_schemas_logs.py, test_schemas_rigs.py.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from json_schemas import COMMON, SCHEMAS, holds, validator, without_a_key_or_with_another
from jsonschema import Draft202012Validator
from logcommand import barrel_log, run_here
from processes import RIGS, pcpc

from pcpc.tools import cli
from pcpc.tools.dev.bench.options import COMMAND as BENCH
from pcpc.tools.dev.evidence.options import COMMAND as EVIDENCE
from pcpc.tools.dev.evidence.options import SOAK
from pcpc.tools.terminal.command import Command

OPTIONAL = {"ids", "device", "bound", "rig_git"}  # of a summary


def with_json(commands: Sequence[Command], above: str = "") -> Iterator[str]:
    """Yield the names of all commands that take --json."""
    for one in commands:
        names: list[str] = []
        one.arguments(lambda *words, names=names, **about: names.extend(words))  # type: ignore[misc]
        if "--json" in names:
            yield above + one.name
        yield from with_json(one.parts, f"{above}{one.name} ")


def test_every_command_with_json_has_a_schema_and_there_is_no_other() -> None:
    commands = [*cli.COMMANDS.values(), BENCH, EVIDENCE, SOAK]
    names = (name.rpartition(".")[2].replace(" ", "-") for name in with_json(commands))
    assert SCHEMAS.keys() == {*names, COMMON}


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_schema_is_one_and_strict(name: str) -> None:
    Draft202012Validator.check_schema(SCHEMAS[name])
    todo: list[Any] = [SCHEMAS[name]]
    while todo:
        one = todo.pop()
        if isinstance(one, dict):
            assert "properties" not in one or one.get("additionalProperties") is False, one
            todo += one.values()
        elif isinstance(one, list):
            todo += one


def test_the_summary_of_a_run_and_its_requirements(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        f"base: {RIGS / 'step10.yaml'}\nduration_s: 0.2\nevaluation: {{window_s: [0, 0.2]}}\n"
        "require: [{id: R-1, never: abs(controller.e_rad) > 1000}, "
        "{when: time.t_s > 9, then: time.t_s > 0}, {always: sqrt(0 - time.t_s) < 1}]\n"
        "expect: {pd: {muzzle_error_rms_mrad: {low: 0, high: 1000, id: R-2}}}\n"
    )
    done = run_here("simulate", rig, "-o", tmp_path / "a", "--no-figure", "--quiet", "--json")
    told = holds("simulate", done.out)
    assert told["ids"] == {"muzzle_error_rms_mrad": "R-2"}
    assert holds("log require", run_here("log", "require", tmp_path / "a", "--json").out)
    text = run_here("log", "recover", tmp_path / "a", "-o", tmp_path / "b.mcap", "--json").out
    assert holds("log recover", text)


def test_the_summary_of_real_processes(tmp_path: Path) -> None:
    done = pcpc(
        "run",
        "slew10",
        "--pacing",
        "lockstep",
        "--set",
        "duration_s=0.2",
        "--no-figure",
        "--quiet",
        "--json",
        "-o",
        str(tmp_path / "a"),
    )
    assert holds("run", done.out)["pacing"] == "lockstep", done


def test_the_rigs() -> None:
    assert len(holds("rigs", run_here("rigs", "--json").out)) > 20


@pytest.mark.parametrize("command", ["simulate", "rigs", "check", "bus", "log info", "replay"])
def test_a_key_that_is_missing_or_new_is_found(command: str, tmp_path: Path) -> None:
    short = "slew10", "--set", "duration_s=0.1", "--no-figure", "--quiet", "-o", tmp_path / "a"
    words = {"simulate": short, "check": ["probe"], "bus": ["hull"], "rigs": []}
    done = run_here(*command.split(), *words.get(command, [barrel_log("pd")]), "--json")
    for key, other in without_a_key_or_with_another(holds(command, done.out)):
        may_lack = command == "simulate" and key in OPTIONAL
        assert validator(command).is_valid(other) == may_lack, key
