"""What the executive declares stands so in every DBC file, in the docs and in a device's C."""

import re
import runpy
from pathlib import Path

import pytest

from pcpc.drivers.can.e2e import MAX_DELTA
from pcpc.drivers.canopen.layout import Heartbeat
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.limits import Quick
from pcpc.executive.loop.states import NEXT, Condition, State
from pcpc.executive.nodes.planned_run import PATIENCE_S
from pcpc.tools.dev import declarations
from pcpc.tools.make.generate import declared

FILES = dict(declarations.rewritten())


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_file_has_the_table_that_is_declared(file: Path) -> None:
    assert file.read_text(encoding="utf-8") == FILES[file], (
        "write it: python -m pcpc.tools.dev.declarations"
    )


def test_the_tables_are_found() -> None:
    texts = [text for file, text in FILES.items() if file.suffix == ".dbc"]
    assert sum('mode 0 "INIT"' in text for text in texts) > 10
    assert FILES[declarations.PAGE].count("| ramp |") == 11


def test_a_changed_table_is_written_anew() -> None:
    row = declarations.fault_row(Fault.BUS_OFF)
    page = FILES[declarations.PAGE].replace(row, row.replace("1 cycle", "9 cycles"))
    rows = "".join(map(declarations.fault_row, list(Fault)[1:]))
    assert declarations._ROWS.sub(rows, page) == FILES[declarations.PAGE]


def test_the_C_of_a_device_numbers_everything_as_declared() -> None:
    files = declared.files()
    told = dict(re.findall(r"^    (\w+) = (\d+),$", files["supervisor.h"], re.MULTILINE))
    for kind in (State, Condition, Fault, Quick):
        for one in kind:
            assert told[f"{kind.__name__.upper()}_{one.name}"] == str(int(one))
    rows = re.findall(r"^    \{((?:STATE_\w+(?:, )?)+)\},$", files["supervisor.c"], re.MULTILINE)
    table = [[State[name.removeprefix("STATE_")] for name in row.split(", ")] for row in rows]
    assert table == NEXT.tolist()


def test_the_codec_in_C_takes_the_same_gap_of_the_counter() -> None:
    codec = (declarations.ROOT / "tools/make/generate/c/codec.c").read_text("utf-8")
    assert re.findall(r"^#define MAX_DELTA (\d+)u", codec, re.MULTILINE) == [str(MAX_DELTA)]


@pytest.mark.parametrize(
    "file", ["plants/probe/device/probe.py", "tools/make/template/device/device.py"]
)
def test_a_device_that_stands_alone_repeats_what_is_declared(file: str) -> None:
    its = runpy.run_path(str(declarations.ROOT / file))
    assert its["NMT"] == {state: state.heartbeat for state in State if state in its["NMT"]}
    assert (its["READY"], its["RUN"], its["STOPPED"]) == (State.READY, State.RUN, Heartbeat.STOPPED)
    assert (its["MAX_DELTA"], its["PATIENCE_S"]) == (MAX_DELTA, PATIENCE_S)


def test_one_in_C_does_so_too() -> None:
    text = (declarations.ROOT / "plants/probe/device/probe.c").read_text("utf-8")
    its = {name: int(number) for name, number in re.findall(r"\b([A-Z_]+) = (\d+)\b", text)}
    beats = Heartbeat.STOPPED, Heartbeat.OPERATIONAL, Heartbeat.PRE_OPERATIONAL
    for one in (State.READY, State.RUN, State.STOP, *beats):
        assert its[one.name] == one
    assert (its["MAX_DELTA"], its["PATIENCE_MS"]) == (MAX_DELTA, 1000 * PATIENCE_S)
