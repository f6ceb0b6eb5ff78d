"""Runs of other settings and seeds: each the one that its rig, read from the file, would do."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from pcpc.drivers.compiled.lanes import WIDTH
from pcpc.executive.batch.group import LaneGroup
from pcpc.executive.batch.runs import BatchRuns, Case
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig

pytestmark = pytest.mark.deep

BARREL = ROOT / "plants/atb1000/rigs/firetrack.yaml"
WANTED = {"executive": ["rx.FB_A.hub_rate"], "plant": ["barrel.theta_rad"]}
LAST = "    x.integral_V += where(winds_up, 0.0, dt * p.ki_V_rads * y.e_rad)  # (5)\n"


def motor_with(folder: Path, line: str) -> Path:
    shutil.copytree(ROOT / "tools/make/template", folder)
    law = folder / "laws/pid.py"
    assert LAST in law.read_text()
    law.write_text(law.read_text().replace(LAST, f"{LAST}    {line}\n"))
    return folder / "rig.yaml"


def test_a_seed_gives_its_noise_in_lanes_too_also_where_nothing_else_is_changed() -> None:
    runs = BatchRuns(BARREL, "pd_nn", ["duration_s=0.2"], WANTED)  # type: ignore[arg-type]
    cases = [Case(seed, {"barrel.gap_rad": 2e-4 * seed}) for seed in range(1, WIDTH - 1)]
    cases.append(Case(77))
    done = runs.done(cases)
    assert {one.alone for one in done} == {""}
    told = set()
    for case, one in zip(cases, done, strict=True):
        alone = in_memory(runs.rig_of(case))
        assert one.log is not None
        for node, names in WANTED.items():
            for name in names:
                column = one.log.node[node].columns[name]
                assert column.tobytes() == alone.node[node].columns[name].tobytes(), (node, name)
        told.add(float(one.log.node["plant"].columns["barrel.theta_rad"][-1]))
    assert len(told) == len(cases), "each seed its own"


def test_what_is_no_setting_of_a_block_is_done_alone_and_says_so() -> None:
    runs = BatchRuns(ROOT / "tools/make/template/rig.yaml", "pid", [], {})
    (done,) = runs.done([Case(1, {"duration_s": 0.05})])
    assert done.alone == "duration_s is not a setting of a block"
    assert done.log is not None and len(done.log.node["executive"].cycle) == 50


def test_runs_that_branch_otherwise_are_parted_and_their_like_stay_in_lanes(tmp_path: Path) -> None:
    """Two of eight are of another kind, one is refused, and one alone would stop the others."""
    rig = motor_with(tmp_path / "motor", "if p.ki_V_rads > 100.0: y.e_rad += 0.0 * p.weight")
    runs = BatchRuns(rig, "pid", ["duration_s=0.05"], {"plant": ["motor.angle_rad"]})
    gains = [10.0, 10.0, 200.0, 10.0, -5.0, 200.0, 10.0, 300.0]
    cases = [Case(i, {"controller.ki_V_rads": gain}) for i, gain in enumerate(gains)]
    done = runs.done(cases)
    assert [bool(one.refused) for one in done] == [gain < 0.0 for gain in gains]
    assert [bool(one.alone) for one in done] == [gain == 300.0 for gain in gains]
    for case, one in zip(cases, done, strict=True):
        if one.log is not None:
            alone = in_memory(runs.rig_of(case)).node["plant"].columns["motor.angle_rad"]
            assert one.log.node["plant"].columns["motor.angle_rad"].tobytes() == alone.tobytes()


def test_an_output_that_nobody_sends_is_looked_at_too(tmp_path: Path) -> None:
    rig = motor_with(tmp_path / "motor", "y.speed_rad_s = 1.0 / p.weight")
    group = LaneGroup(load_rig(rig, settings=["duration_s=0.02"]), {})
    group.begin()
    place = group.plans["executive"].table.index["controller.weight"]
    for lane in range(WIDTH):
        group.put(lane, "executive", {place: 0.0 if lane == 6 else 1.0})
    assert np.flatnonzero(group.run()).tolist() == [6]


def test_a_step_that_does_not_return_ends_the_campaign_with_its_name(tmp_path: Path) -> None:
    rig = motor_with(
        tmp_path / "motor", "while t > 0.3 and p.weight < 1.0:\n        y.e_rad += 0.0"
    )
    words = [sys.executable, "-m", "pcpc.tools.cli", "sweep", str(rig), "--draws", "9", "--quiet"]
    done = subprocess.run(
        [*words, "-o", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        timeout=240.0,
        check=False,
    )
    assert (done.returncode, done.stdout) == (5, ""), str(done)
    assert done.stderr.endswith("the step of controller does not return\n"), done.stderr
