"""Runs of other settings and seeds: each the one that its rig, read from the file, would do."""

import shutil
from pathlib import Path

import numpy as np

from pcpc.drivers.lanes import WIDTH
from pcpc.executive.batch.group import Group
from pcpc.executive.batch.runs import Case, Runs
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig

ROOT = Path(__file__).resolve().parents[2]
BARREL = ROOT / "plants/atb1000/rigs/firetrack.yaml"
WANTED = {"executive": ["rx.FB_A.hub_rate"], "plant": ["barrel.theta_rad"]}


def test_a_seed_gives_its_noise_in_lanes_too_also_where_nothing_else_is_changed() -> None:
    runs = Runs(BARREL, "pd_nn", ["duration_s=0.2"], WANTED)  # type: ignore[arg-type]
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
    runs = Runs(ROOT / "tools/template/rig.yaml", "pid", [], {})
    (done,) = runs.done([Case(1, {"duration_s": 0.05})])
    assert done.alone == "duration_s is no setting of a block"
    assert done.log is not None and len(done.log.node["executive"].cycle) == 50


def test_an_output_that_nobody_sends_is_looked_at_too(tmp_path: Path) -> None:
    folder = tmp_path / "motor"
    shutil.copytree(ROOT / "tools/template", folder)
    control = folder / "control.py"
    last = "    x.integral_V += where(winds_up, 0.0, dt * p.ki_V_rads * y.e_rad)  # (5)\n"
    text = control.read_text()
    assert last in text
    control.write_text(text.replace(last, f"{last}    y.speed_rad_s = 1.0 / p.weight\n"))
    group = Group(load_rig(folder / "rig.yaml", settings=["duration_s=0.02"]), {})
    group.begin()
    place = group.plans["executive"].table.index["controller.weight"]
    for lane in range(WIDTH):
        group.put(lane, "executive", {place: 0.0 if lane == 6 else 1.0})
    assert np.flatnonzero(group.run()).tolist() == [6]
