"""`pcpc simulate --digest`: what a page of `pcpc generate web` shows, from the log alone."""

from pathlib import Path

import numpy as np
import pytest
from logcommand import run_here

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.run_digest import run_digest
from pcpc.tools.make.web.contents import digest
from pcpc.tools.make.web.program import Program
from pcpc.tools.start.rigs import find


@pytest.mark.parametrize("rig", ["slew10", "telerobot-u1", "two-deadzones", "suspension-58"])
def test_simulate_prints_the_digest_of_the_page(rig: str, tmp_path: Path) -> None:
    words = ("simulate", rig, "--set", "duration_s=0.1", "--set", "seed=3", "--no-figure")
    done = run_here(*words, "--quiet", "--digest", "-o", tmp_path / "run")
    made = load_rig(Path(find(rig)), None, ["duration_s=0.1", "seed=3"])
    expected = digest(Program(made), in_memory(made))
    assert done.out.splitlines()[-1] == f"digest   {expected}", done
    assert "digest" not in run_here(*words, "--quiet", "-o", tmp_path / "other").out
    assert run_digest(logs.read(tmp_path / "other" / "log.mcap")) == expected


def test_each_state_and_output_counts_with_each_bit_and_sign(tmp_path: Path) -> None:
    log = in_memory(load_rig(Path(find("slew10")), None, ["duration_s=0.05"]))
    whole = run_digest(log)
    for node, name in (("executive", "controller.e_rad"), ("plant", "barrel.x_q_0")):
        column = log.node[node].columns[name]
        for other in (np.nextafter(column[49], np.inf), np.nan, -0.0):
            column[49], before = other, column[49]
            assert run_digest(log) != whole, (name, other)
            column[49] = before
    log.node["executive"].columns["supervisor.state"][3] = 9.0
    assert run_digest(log) == whole, "not of a block"
    log.node["plant"].columns["barrel.x_q_0"][50] = 9.0
    assert run_digest(log) == whole, "a cycle behind the last of the run"


@pytest.mark.parametrize(
    ("more", "said"), [("--json", "leave out --json"), ("--set=record.keep=50ms", "record.keep")]
)
def test_a_digest_is_of_a_whole_run_and_a_line(more: str, said: str, tmp_path: Path) -> None:
    done = run_here("simulate", "slew10", "--digest", more, "-o", tmp_path / "run")
    assert done.code == 2 and said in done.err and not (tmp_path / "run").exists(), done
