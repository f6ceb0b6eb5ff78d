"""`pcpc replay --cycle`: a cycle of a log with all its variables, recorded or not."""

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_schemas import holds
from logcommand import run_here
from processes import RIGS

from pcpc.executive.log import reader as logs
from pcpc.executive.loop.exchange import run_of
from pcpc.executive.nodes.virtual import VirtualRun, simulate
from pcpc.executive.rig.reading import Rig, load_rig

CYCLES = 300


def rig() -> Rig:
    return load_rig(RIGS / "engage.yaml", settings=[f"duration_s={CYCLES / 1000}"])


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("step") / "log.mcap"
    simulate(rig(), path)
    return path


def stepped(log: Path, cycle: int, *words: str) -> dict[str, dict[str, Any]]:
    done = run_here("replay", log, "--cycle", str(cycle), "--quiet", "--json", *words)
    assert done.code == 0, done
    return {one["node"]: one for one in holds("replay --cycle", done.out)}


def test_recorded_values_are_those_of_the_log(log: Path) -> None:
    read = logs.read(log)
    drawn = random.Random("step")
    for cycle in (0, CYCLES - 1, *(drawn.randrange(CYCLES) for _ in range(8))):
        for role, one in stepped(log, cycle).items():
            node = read.node[role]
            row = int(np.flatnonzero(node.cycle == cycle)[0])
            parameters = {name for name in node.columns if name not in one["values"]}
            assert {n for n in parameters if n not in node.description["ranges"]} == set()
            for name in node.columns.keys() & one["values"].keys():
                assert float(one["values"][name]) == node.columns[name][row], (cycle, name)
            mine = node.frames[(node.frames["cycle"] == cycle) & (node.frames["direction"] == 0)]
            assert len(one["sent"]) == len(mine)


def test_what_no_log_has_is_that_of_a_run_that_is_left_there(log: Path) -> None:
    cycle = 177
    run = VirtualRun(rig(), None)
    loops = tuple(block.loop for block in run.blocks)
    run_of(2)(loops, run.steps, cycle + 1)
    found = stepped(log, cycle, "--node", "executive", "--show", "*")["executive"]["values"]
    places = run.plans[0].table.index
    hidden = found.keys() - logs.read(log).node["executive"].columns.keys()
    assert len(hidden) > 30, "states and parameters that are not recorded"
    for name in found:
        assert float(found[name]) == loops[0].v[places[name]], name


def test_the_text_has_the_stages_in_order(log: Path) -> None:
    done = run_here("replay", log, "--time", "0.1", "--node", "executive", "--quiet")
    lines = done.out.splitlines()
    assert lines[0] == "executive, cycle 100 (0.1 s)"
    order = ["  frame in", "signals in", "block reference", "block controller", "signals out",
             "  frame out"]  # fmt: skip
    at = [next(i for i, line in enumerate(lines) if line.startswith(one)) for one in order]
    assert at == sorted(at)
    assert all(len(line) <= 80 for line in lines)


def test_a_limited_command_says_what_was_wanted(tmp_path: Path) -> None:
    settings = [
        "duration_s=0.1",
        "executive.limits.CMD.motor_torque.low=-0.01",
        "executive.limits.CMD.motor_torque.high=0.01",
    ]
    simulate(load_rig(RIGS / "hull.yaml", settings=settings), tmp_path / "log.mcap")
    done = run_here("replay", tmp_path, "--cycle", "90", "--show", "tx.CMD.motor_torque", "--quiet")
    assert "limited" in done.out, done
    assert "0.01  N m limited, " in done.out, done


def test_a_part_of_a_log_is_shown_as_far_as_it_goes(log: Path, tmp_path: Path) -> None:
    data = log.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: 2 * len(data) // 3])
    done = run_here("replay", tmp_path / "cut.mcap", "--cycle", str(CYCLES - 1), "--quiet")
    assert done.code in (2, 3), done
    assert json.dumps(done.out) == '""'
