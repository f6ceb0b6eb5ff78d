"""What every command prints with --json is of its schema in docs/reference/schemas, and strict.

A command with --json and without a case here fails, so does a schema of no command. Odd logs and
signals: test_json_odd.py; running nodes: test_json_live.py.
"""

import copy
import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from json_schemas import COMMON, SCHEMAS, file_of, holds, strictly_holds
from jsonschema import Draft202012Validator
from logcommand import DBC, barrel_log, run_here
from places import ROOT
from processes import PCPC, RIGS, own_bus, pcpc

from pcpc.drivers.can import bus as buses
from pcpc.tools import cli
from pcpc.tools.dev.bench.options import COMMAND as BENCH
from pcpc.tools.dev.evidence.options import COMMAND as EVIDENCE
from pcpc.tools.dev.evidence.options import SOAK
from pcpc.tools.terminal.command import Command

FORMS = "get --long", "replay --cycle", "replay --brief", "compare --bits"  # others of a command
QUICKLY = "--no-figure --quiet"
SHORT = f"slew10 --set duration_s=0.1 {QUICKLY}"
HERE = [  # command, its other words beside the files of `folder`, exit code
    ("rigs", "", 0), ("check", "hull", 0), ("check", "probe", 0), ("doctor", "", 0),
    ("simulate", f"{SHORT} -o made", 1), ("branch", f"a.mcap --cycle 200 -o made {QUICKLY}", 1),
    ("bus", "hull", 0), ("bus", "hull --bitrate 125k", 1), ("replay", "a.mcap --quiet", 0),
    ("replay --cycle", "5 a.mcap --quiet", 0), ("replay --brief", "a.mcap --jobs 1 --quiet", 0),
    ("compare", "a.mcap b.mcap --quiet", 1), ("bounds", "slew10 --set duration_s=0.1 --quiet", 0),
    ("log info", "a.mcap", 0), ("log info", "made.mcap", 0),
    ("compare --bits", "a.mcap a.mcap", 0), ("compare --bits", "a.mcap b.mcap", 1),
    ("log recover", "a.mcap -o new.mcap", 0), ("report", "run --requirements", 1),
    ("log import", f"frames.blf --dbc {DBC} -o new.mcap", 0),
    *(("log export", f"a.mcap -o {name}", 0)
      for name in ("new.log", "new.blf", "new.asc", "new.csv", "new.mf4")),
]  # fmt: skip
APART = {"run", "bus emulate", "play", "jitter", "margin", "fit"}
LIVE = {
    "get", "get --long", "set", "load", "undo", "watch", "scope", "stop", "fault",
    *(f"operate {verb}" for verb in ("lock", "reset", "arm", "hold", "resume", "handover")),
}  # fmt: skip
WHERE_THEY_ARE = {  # what takes a repository, minutes, or a machine
    "bisect": "tests/tools/after/bisect/test_bisect.py",
    "bench": "tests/tools/dev/test_bench_suites.py",
    "soak": "tests/tools/dev/evidence/test_soak.py",
    "swarm": "tests/tools/study/test_swarm.py",
}


def with_json(commands: Sequence[Command], above: str = "") -> Iterator[str]:
    """Yield the names of all commands that take --json."""
    for one in commands:
        names: list[str] = []
        one.asked.add_to(lambda *words, names=names, **about: names.extend(words))  # type: ignore[misc]
        if "--json" in names:
            yield above + one.name.rpartition(".")[2]
        yield from with_json(one.parts, f"{above}{one.name} ")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two logs, a run with ids and requirements, and a recording."""
    made = tmp_path_factory.mktemp("json")
    (made / "a.mcap").hardlink_to(barrel_log("pd"))
    (made / "b.mcap").hardlink_to(barrel_log())
    (made / "rig.yaml").write_text(
        f"base: {RIGS / 'step10.yaml'}\nduration_s: 0.2\nevaluation: {{window_s: [0, 0.2]}}\n"
        "require: [{id: R-1, never: abs(controller.e_rad) > 1000}, "
        "{when: time.t_s > 9, then: time.t_s > 0}, {always: sqrt(0 - time.t_s) < 1}]\n"
        "expect: {pd: {muzzle_error_rms_mrad: {low: 0, high: 1000, id: R-2}}}\n"
    )
    words = "simulate", made / "rig.yaml", "-o", made / "run", *QUICKLY.split(), "--json"
    assert holds("simulate", run_here(*words).out)["ids"] == {"muzzle_error_rms_mrad": "R-2"}
    run_here("log", "export", made / "a.mcap", "-o", made / "frames.blf")
    run_here("log", "import", made / "frames.blf", "--dbc", DBC, "-o", made / "made.mcap")
    return made


def test_every_command_with_json_has_a_schema_and_a_case_and_there_is_no_other() -> None:
    names = {*with_json([*cli.COMMANDS.values(), BENCH, EVIDENCE, SOAK]), *FORMS}
    assert SCHEMAS.keys() == {*map(file_of, names), COMMON}
    assert names == {name for name, *_ in HERE} | APART | LIVE | WHERE_THEY_ARE.keys()
    for name, file in WHERE_THEY_ARE.items():
        assert f'strictly_holds("{name}", ' in (ROOT / file).read_text(), file


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_schema_is_one_and_strict(name: str) -> None:
    Draft202012Validator.check_schema(SCHEMAS[name])
    todo: list[Any] = [SCHEMAS[name]]
    while todo:
        one = todo.pop()
        if isinstance(one, dict):
            closed = one.get("additionalProperties") is False or "propertyNames" in one
            assert "properties" not in one or closed or "$ref" in one, one
            todo += one.values()
        elif isinstance(one, list):
            todo += one


WEAKER = [  # key of the schema of `set`, what it says instead, the lie that is not seen then
    (("required",), ["cycle", "values"], "(): no before"),
    (("additionalProperties",), True, "(): a new key"),
    (("properties", "cycle"), {}, "('cycle',): another type"),
    (("properties", "cycle", "type"), ["integer", "string"], "('cycle',): another type"),
    (("properties", "values", "additionalProperties"), {}, "('values', 'a.b'): another type"),
]


@pytest.mark.parametrize(("place", "weaker", "lie"), WEAKER)
def test_a_schema_that_lets_a_lie_pass_is_found(
    place: tuple[str, ...], weaker: Any, lie: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = '{"cycle": 1, "values": {"a.b": 2.0}, "before": {"a.b": null}}'
    strictly_holds("set", text)
    weak = changed = copy.deepcopy(SCHEMAS["set"])
    for key in place[:-1]:
        changed = changed[key]
    changed[place[-1]] = weaker
    monkeypatch.setitem(SCHEMAS, "set", weak)
    with pytest.raises(AssertionError, match=re.escape(lie)):
        strictly_holds("set", text)


@pytest.mark.parametrize(("command", "words", "code"), HERE)
@pytest.mark.quick
def test_what_a_command_prints_is_of_its_schema(
    command: str, words: str, code: int, folder: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    for made in folder.iterdir():
        (tmp_path / made.name).symlink_to(made)
    monkeypatch.chdir(tmp_path)
    form = ("--json", "-") if command.startswith("compare") else ("--json",)
    done = run_here(*command.split(), *shlex.split(words), *form)
    assert done.code == code, done
    strictly_holds(command, done.out)


def test_a_run_in_lockstep_and_each_of_its_nodes_alone(tmp_path: Path) -> None:
    """The executive is a device of the plant, which keeps what it says."""
    short = *QUICKLY.split(), "--json", "--pacing", "lockstep", "--set", "duration_s=0.2"
    done = pcpc("run", "slew10", *short, "-o", str(tmp_path / "run"))
    assert strictly_holds("run", done.out)["pacing"] == "lockstep", done
    device = (
        PCPC,
        "run",
        "--only=executive",
        "slew10",
        *short,
        "--bus",
        "{bus}",
        "-o",
        str(tmp_path / "exec"),
    )
    words = "slew10", *short, "--bus", own_bus(), "-o", str(tmp_path / "plant")
    done = pcpc("run", "--only=plant", *words, "--device", *device)
    assert strictly_holds("run", done.out)["device"], done
    strictly_holds("run", (tmp_path / "plant/device.txt").read_text())


def test_a_bus_is_emulated_and_a_log_played() -> None:
    """In processes of their own: they lock their memory."""
    first = own_bus()
    second = str(buses.neighbour_of(buses.bus_named(*buses.parse(first))))
    done = pcpc("bus", "emulate", first, second, "--for", "100ms", "--json", "--quiet")
    assert done.code == 0 and len(strictly_holds("bus emulate", done.out)["sides"]) == 2, done
    words = "play", str(barrel_log("pd")), "--bus", own_bus(), "--json", "--quiet"
    done = pcpc(*words)
    assert done.code == 0 and strictly_holds("play", done.out)["timing_error_us"], done
    assert holds("play", run_here(*words, "--rate", "0").out)["timing_error_us"] is None


def test_lateness_is_measured(tmp_path: Path) -> None:
    words = "jitter", "-q", "-D", "200ms", "--rounds", "1", "--bus", own_bus()
    assert run_here(*words, "--json", tmp_path / "jitter.json").code == 0
    found = strictly_holds("jitter", (tmp_path / "jitter.json").read_text())
    assert found["loops"]["pcpc"]["cycles"]


@pytest.mark.deep
def test_margins_of_a_loop() -> None:
    words = "margin", "probe", "--json", "--lowest", "5", "--settle", "500ms"
    found = strictly_holds("margin", run_here(*words).out)
    assert found["measured"]["coherence"] and found["linearised"]["margins"]["gain_margin"]
    alone = holds("margin", run_here(*words, "--method", "linearised").out)
    assert alone["measured"] is None


@pytest.mark.deep
def test_a_plant_is_fitted(tmp_path: Path) -> None:
    assert run_here("new", tmp_path / "motor").code == 0
    rig, run = tmp_path / "motor/rig.yaml", tmp_path / "run"
    assert run_here("simulate", rig, "-o", run, "--quiet", "--no-figure").code == 0
    words = "fit", rig, run, "--parameter", "motor.coulomb_Nm", "--quiet", "--json"
    found = strictly_holds("fit", run_here(*words, "-o", tmp_path / "fitted").out)
    assert found["arrived"] and Path(found["folder"]) == tmp_path / "fitted"
