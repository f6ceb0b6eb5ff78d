"""pya2ldb and a2ltool, parsers of two hands, read in an A2L file what the node's table has."""

import json
import platform
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from logcommand import run_here

from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.live.xcp.a2l import A2lVariable, a2l_text, ethernet
from pcpc.tools.start import rigs

FAR = 1e300
CASES = [
    ("hull", "pd_nn", "executive"),
    ("hull", "pd", "plant"),
    ("friction-a", "nn_ramp", "executive"),
]
OBJECT = re.compile(
    r"^( *)(Characteristic|Measurement|CompuMethod|Group) \{\n(.*?)^\1\}", re.M | re.S
)
OF_LOOP = "timing", "supervisor"
LEAF = re.compile(
    r'(?:String|EnumItem)\(\s*\d+,\s*"([^"]*)"|U(?:Int|Char|Long)\(\s*\d+,\s*\(\s*(\d+)'
)
a2ltool_there = pytest.mark.skipif(
    platform.machine() != "x86_64", reason="a2ltool has no wheel for this machine"
)


class One(NamedTuple):
    """An entry of the file."""

    tunable: bool
    address: int
    size: int
    unit: str
    low: float
    high: float
    help: str


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def case(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, One]]:
    """Return the file of a node, and what its table has, without arrays."""
    rig, controller, node = request.param
    path = tmp_path_factory.mktemp("a2l") / "node.a2l"
    done = run_here("generate", "a2l", rig, "--controller", controller, "--node", node, "-o", path)
    assert done.code == 0, done
    found = load_rig(Path(rigs.find(rig)), controller, [])
    expected = {}
    for number, one in enumerate(plan(found, node, "lockstep").table.variables):
        tunable = one.kind == "parameter"
        low, high = (one.low, one.high) if tunable else (-FAR, FAR)
        text = re.sub(r"\s+", " ", one.help)
        if not (one.recorded or (tunable and one.name.split(".")[0] not in OF_LOOP)):
            text += " (polled only)"
        limits = max(low, -FAR), min(high, FAR)
        expected[one.name] = One(tunable, 8 * number, 1, one.unit, *limits, text)
    return path, expected


class Read(NamedTuple):
    """What a parser has read: entries, members of groups, values of IF_DATA."""

    entries: dict[str, One]
    groups: dict[str, list[str]]
    interface: "Counter[str]"


def by_pya2ldb(path: Path) -> tuple[Read, Any]:
    """Return what pya2ldb reads, and its IF_DATA by tags."""
    from pya2l import import_a2l, model  # half a second, for each worker at the top

    session = import_a2l(str(path), in_memory=True, encoding="utf-8", progress_bar=False)
    units = {one.name: one.unit for one in session.query(model.CompuMethod)}
    entries = {}
    for kind in (model.Characteristic, model.Measurement):
        for one in session.query(kind):
            tunable = kind is model.Characteristic
            numbers = list(one.matrix_dim.numbers) if one.matrix_dim else [1]
            assert not tunable or one.type == ("VAL_BLK" if one.matrix_dim else "VALUE"), one.name
            at = one.address if tunable else one.ecu_address.address
            limits = one.lowerLimit, one.upperLimit
            entries[one.name] = One(
                tunable, at, numbers[0], units[one.conversion], *limits, one.longIdentifier
            )
    groups = {}
    for one in session.query(model.Group):
        assert one.groupName not in groups, f"two groups {one.groupName}"
        refs = [one.ref_characteristic, one.ref_measurement]
        groups[one.groupName] = [name for ref in refs if ref for name in ref.identifier]
    session.setup_ifdata_parser()
    interface, *events = session.parse_ifdata(session.query(model.IfData).all())
    polled = [one for one in entries.values() if one.help.endswith(" (polled only)")]
    assert events == [{"XCP": [{"DAQ_EVENT": {"FIXED_EVENT_LIST": {}}}]}] * len(polled) != []
    leaves = Counter(str(leaf) for leaf in leaves_of(interface) if leaf is not True)
    return Read(entries, groups, leaves), interface


def leaves_of(value: Any) -> Iterator[Any]:
    """Yield the values of nested lists and objects."""
    if isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            yield from leaves_of(part)
    else:
        yield value


def by_a2ltool(path: Path) -> Read:
    """Return what a2ltool prints of what it has read, strictly and without a complaint."""
    tool = Path(sys.executable).with_name("a2ltool")
    words = [tool, "--strict", "--check", "--show-xcp", "-v", "--debug-print", path]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "No problems found" in done.stdout, done.stdout[-2000:]
    assert re.search(r"XCP on UDP/IP\n +address: 127.0.0.1\n +port: 555[56]\n", done.stdout)
    units, entries, groups = {}, {}, {}
    for _, kind, body in OBJECT.findall(done.stdout):
        fields = dict(re.findall(r"(\w+): (\"[^\n]*\"|[-\d.e]+),\n", body)[::-1])
        name = fields["name"].strip('"')
        assert ('"DAQ_EVENT"' in body) == ("(polled only)" in body), name
        if kind == "Group":
            assert name not in groups, f"two groups {name}"
            lists = re.findall(r"identifier_list: \[(.*?)\]", body, re.S)
            groups[name] = [one for part in lists for one in re.findall(r'"(.*?)"', part)]
        elif kind == "CompuMethod":
            units[name] = json.loads(fields["unit"])
        else:
            size = re.search(r"dim_list: \[\s*(\d+)", body)
            assert ("ValBlk" in body) == (kind == "Characteristic" and size is not None), name
            entries[name] = One(
                kind == "Characteristic",
                int(fields["address"]),
                int(size[1]) if size else 1,
                fields["conversion"].strip('"'),
                float(fields["lower_limit"]),
                float(fields["upper_limit"]),
                json.loads(fields["long_identifier"]),
            )
    entries = {name: one._replace(unit=units[one.unit]) for name, one in entries.items()}
    begin = done.stdout.rindex("ifdata_items: Some", 0, done.stdout.index('"PROTOCOL_LAYER": ['))
    interface = done.stdout[begin:]
    leaves = Counter(text or number for text, number in LEAF.findall(interface))
    return Read(entries, groups, leaves)


def test_the_variables_are_those_of_the_table(case: tuple[Path, dict[str, One]]) -> None:
    path, expected = case
    entries = by_pya2ldb(path)[0].entries
    assert {name: one for name, one in entries.items() if one.size == 1} == expected
    arrays = {name: one for name, one in entries.items() if one.size > 1}
    assert len(arrays) >= 5, arrays
    for name, one in arrays.items():
        elements = [expected[f"{name}_{i}"] for i in range(one.size)]
        assert [e.address for e in elements] == [one.address + 8 * i for i in range(one.size)]
        assert {e._replace(address=0) for e in elements} == {one._replace(address=0, size=1)}
        assert f"{name}_{one.size}" not in expected, name


def test_a_group_has_all_of_a_block_and_an_event_its_period(
    case: tuple[Path, dict[str, One]],
) -> None:
    read, interface = by_pya2ldb(case[0])
    for name in read.entries:
        assert read.groups[f"G_{name.partition('.')[0]}"].count(name) == 1, name
    assert sum(map(len, read.groups.values())) == len(read.entries)
    events = interface["XCP"][0]["DAQ"][-1]["EVENT"]
    assert [(one[0], one[5], one[6]) for one in events] == [
        ("cycle", 1, 6),
        ("cycle_10", 1, 7),
        ("cycle_100", 1, 8),
    ], events


def test_a_parameter_that_a_fault_changes_is_polled_only(tmp_path: Path) -> None:
    rig, file = tmp_path / "rig.yaml", tmp_path / "a.a2l"
    fault = "{weak: {kind: gain, at: controller.kv_Nms_rad, value: 0.5}}"
    rig.write_text(f"base: {Path(rigs.find('hull')).resolve()}\nfaults: {fault}\n")
    assert run_here("generate", "a2l", rig, "-o", file).code == 0
    text = file.read_text()
    assert 'controller.kv_Nms_rad "gain on the filtered error (polled only)"' in text
    assert 'controller.lam_per_s "slope of the filtered error"' in text


def test_gains_that_a_drive_takes_from_its_bus_are_polled_only(tmp_path: Path) -> None:
    rig, file = Path(__file__).parents[3] / "drivers/robots/odrive.yaml", tmp_path / "a.a2l"
    assert run_here("generate", "a2l", rig, "--node", "plant", "-o", file).code == 0
    polled = re.findall(r"CHARACTERISTIC (\S+) .* \(polled only\)\"\n", file.read_text())
    gains = ["position_gain_per_s", "velocity_gain", "integral_gain_per_s"]
    assert [one for one in polled if one.startswith("drive.")] == [f"drive.{one}" for one in gains]
    assert {one.partition(".")[0] for one in polled} == {"drive", "supervisor", "timing"}


def test_a_long_help_with_quotes_ends_with_its_text(tmp_path: Path) -> None:
    helps = ["a" * 254 + '"b', "c" * 254 + "\\\\d"]
    variables = [A2lVariable(f"x.v{i}", "", help_, None, i > 0) for i, help_ in enumerate(helps)]
    path = tmp_path / "a.a2l"
    path.write_text(a2l_text("rig", "node", "1", 10**6, variables, ethernet([("UDP", "::", 1)])))
    from pya2l import import_a2l, model  # half a second, for each worker at the top

    session = import_a2l(str(path), in_memory=True, encoding="utf-8", progress_bar=False)
    read = [one.longIdentifier for one in session.query(model.Measurement)]
    assert read[0] == "a" * 240 + " (polled only)"
    assert read[1].rstrip("\\") == "c" * 254 != read[1], read  # a parser may leave \\ as it is


@a2ltool_there
def test_both_parsers_agree(case: tuple[Path, dict[str, One]]) -> None:
    ours, theirs = by_pya2ldb(case[0])[0], by_a2ltool(case[0])
    assert theirs.entries == ours.entries
    assert theirs.groups == ours.groups
    assert theirs.interface == ours.interface, theirs.interface - ours.interface
