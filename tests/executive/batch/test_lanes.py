"""A lane equals the single run of its values: all recorded variables, all cycles, bit for bit.

A rig of each plant with a controller of every law, the lanes different in every number that is not
whole (whole ones are counts and switches): so the states differ, and no step may decide by them.
"""

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from places import ROOT

from pcpc.drivers.compiled.lanes import WIDTH, LanesDiffer
from pcpc.executive.batch.group import LaneGroup, NotInLanes
from pcpc.executive.log.reader import Log
from pcpc.executive.nodes.planned_controllers import standby_copies
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import Role

ONE_RIG = (  # of each plant
    "plants/atb1000/rigs/firetrack.yaml",
    "plants/backlash_map/rigs/backlash-map.yaml",
    "plants/backlash_pendulum/rigs/backlash-pendulum.yaml",
    "plants/deadzone_arm/rigs/deadzone-step.yaml",
    "plants/deadzone_map/rigs/fuzzy-d03.yaml",
    "plants/friction_arm/rigs/friction-b.yaml",
    "plants/map_chains/rigs/two-gaps.yaml",
    "plants/payload_arm/rigs/payload-on.yaml",
    "plants/probe/rig.yaml",
    "plants/quarter_car/rigs/suspension-8.yaml",
    "tools/make/template/rig.yaml",
)
COUNTERS = ("health.frames_received", "health.frames_lost", "health.held_cycles",
            "health.stale_cycles", "health.saturated_values", "health.frames_lost_on_purpose",
            "health.frames_sent", "health.passes", "timing.wall_s")  # fmt: skip
Values = dict[Role, dict[int, float]]  # by node and place in its table


def pairs() -> Iterator[tuple[str, str]]:
    for path in ONE_RIG:
        controllers = load_rig(ROOT / path, resolve=False).config.controllers
        laws = {controller.law: name for name, controller in reversed(controllers.items())}
        yield from ((path, name) for name in reversed(laws.values()))
    yield "plants/atb1000/rigs/rough.yaml", "pd"  # in parts of the plant that are off elsewhere


def alone(rig: Rig, values: Values) -> Log:
    """Return the single run of a rig in whose tables other values stand."""
    run = VirtualRun(rig, None)
    for role, block in zip(rig.roles, run.blocks, strict=True):
        for place, value in values.get(role, {}).items():
            block.loop.v[place] = value
    for _ in run.advance():
        pass
    return run.memory.log()


def wanted(rig: Rig) -> dict[Role, list[str]]:
    blocks = VirtualRun(rig, None).blocks
    columns = [block.description["state_columns"] for block in blocks]
    return {role: [*own, *COUNTERS] for role, own in zip(rig.roles, columns, strict=True)}


def moved(group: LaneGroup, lane: int) -> Values:
    """Return the rig's parameters and first states, those not whole 1 % off, in each lane else."""
    rng = np.random.default_rng(lane)
    found: Values = {}
    for role, made in group.plans.items():
        found[role] = {
            place: value * (1.0 + rng.uniform(-0.01, 0.01))
            for place, value in made.values.items()
            if value % 1.0 != 0.0 and not made.names[place].endswith(("_cos", "_sin"))
        }
    return found


def differences(
    log: Log, group: LaneGroup, names: Mapping[Role, list[str]], lane: int
) -> list[str]:
    found = []
    for role, own in names.items():
        node, seat = log.node[role], group.seats[role]
        trace = seat.trace.reshape(-1, len(own), WIDTH)
        rows = group.cycles + (role == "plant")
        if len(node.cycle) != rows:
            found.append(f"{role}: {len(node.cycle)} cycles, {rows} in the lane")
        for i, name in enumerate(own):
            single = node.columns[name] if name in node.columns else node.timing[name]
            if bits(single) != bits(trace[: len(single), i, lane]):
                found.append(f"{role}: {name}")
    return found


def bits(values: NDArray[np.float64]) -> bytes:
    return np.where(np.isnan(values), np.nan, values).tobytes()


@pytest.mark.parametrize(("path", "controller"), list(pairs()))
def test_a_lane_has_the_bits_of_a_single_run(path: str, controller: str) -> None:
    rig = load_rig(ROOT / path, controller, ["duration_s=0.3"])
    names = wanted(rig)
    group = LaneGroup(rig, names)
    group.begin()
    values = [moved(group, lane) for lane in range(WIDTH)]
    for lane, own in enumerate(values):
        for role, one in own.items():
            group.put(lane, role, one)
    odd = group.run()
    assert not odd.any(), "no run of these leaves the path"
    for lane in (0, WIDTH - 1):
        assert differences(alone(rig, values[lane]), group, names, lane) == []


LOSSES = "{FB_A: {share: 0.1, burst: 2}, FB_B: {share: 0.2}, CMD: {share: 0.1, burst: 3}}"


def lossy(folder: Path, supervisor: str, losses: str = LOSSES) -> Path:
    path = folder / "lossy.yaml"
    base = ROOT / "plants/atb1000/rigs/hull.yaml"
    path.write_text(
        f"base: {base}\nrig: lossy\nduration_s: 1.0\nlosses: {losses}\nsupervisor: {supervisor}\n"
    )
    return path


def test_lost_frames_are_lost_as_in_a_single_run_each_by_its_own_seed(tmp_path: Path) -> None:
    path = lossy(tmp_path, "{hold_cycles: 2, fault_after_cycles: 40}")
    rigs = [load_rig(path, "pd_nn", [f"seed={seed}"]) for seed in range(1, WIDTH + 1)]
    names = wanted(rigs[0])
    group = LaneGroup(rigs[0], names)
    group.begin()
    logs = []
    for lane, rig in enumerate(rigs):
        fresh = LaneGroup(rig, {})
        for role, made in fresh.plans.items():
            group.put(lane, role, made.values)
        group.put_seed(lane, rig.config.seed)
        logs.append(alone(rig, {}))
    assert not group.run().any()
    assert [differences(log, group, names, lane) for lane, log in enumerate(logs)] == [[]] * WIDTH
    lost = {float(log.node["executive"].timing["health.frames_lost"][-1]) for log in logs}
    assert len(lost) > WIDTH // 2, "each run loses other frames"


def test_runs_that_fault_are_odd_and_only_those(tmp_path: Path) -> None:
    path = lossy(tmp_path, "{fault_after_cycles: 3}", "{FB_A: {share: 0.006, burst: 2}}")
    rigs = [load_rig(path, "pd", [f"seed={seed}"]) for seed in range(11, 11 + WIDTH)]
    group = LaneGroup(rigs[0], {})
    group.begin()
    for lane, rig in enumerate(rigs):
        group.put_seed(lane, rig.config.seed)
    faulted = [len(alone(rig, {}).node["executive"].cycle) < group.cycles for rig in rigs]
    assert group.run().tolist() == faulted
    assert 0 < sum(faulted) < WIDTH, "the seeds are chosen so"


RATED = "{CMD.voltage: {low: -24.0, high: 24.0, rate_per_s: %s}}"


@pytest.mark.parametrize(("rate", "settles"), [("2000.0", True), ("20.0", False)])
def test_a_limited_rate_is_kept_and_a_command_not_safe_at_the_end_is_odd(
    rate: str, settles: bool, tmp_path: Path
) -> None:
    path = tmp_path / "rated.yaml"
    base, limits = ROOT / "tools/make/template/rig.yaml", RATED % rate
    path.write_text(f"base: {base}\nrig: rated\nduration_s: 0.4\nexecutive: {{limits: {limits}}}\n")
    rig = load_rig(path, "pd")
    names = wanted(rig)
    group = LaneGroup(rig, names)
    group.begin()
    assert group.run().tolist() == [not settles] * WIDTH
    log = alone(rig, {})
    assert log.node["executive"].columns["supervisor.saturated"].any(), "the limit was met"
    if settles:
        assert differences(log, group, names, 0) == []
    else:
        assert len(log.node["executive"].cycle) > group.cycles, "it went on for a ramp"


def test_a_value_that_is_no_number_makes_its_run_odd_and_no_other() -> None:
    rig = load_rig(ROOT / "tools/make/template/rig.yaml", settings=["duration_s=0.2"])
    group = LaneGroup(rig, {})
    group.begin()
    (place,) = (p for p, n in enumerate(group.plans["plant"].names) if n == "motor.inertia_kg_m2")
    group.put(3, "plant", {place: 0.0})
    assert group.run().tolist() == [lane == 3 for lane in range(WIDTH)]


def test_lanes_that_would_branch_differently_are_refused_not_computed() -> None:
    rig = load_rig(ROOT / "plants/atb1000/rigs/hull.yaml", settings=["duration_s=0.05"])
    group = LaneGroup(rig, {})
    group.begin()
    place = group.plans["plant"].names.index("barrel.friction_model")
    group.put(5, "plant", {place: 1.0})
    with pytest.raises(LanesDiffer):
        group.run()
    group.begin()
    assert not group.run().any(), "the memory is as good as new"


def test_a_rig_of_three_nodes_is_not_for_lanes() -> None:
    rig = load_rig(ROOT / "plants/telerobot/rigs/telerobot-u0.yaml")
    with pytest.raises(NotInLanes, match="executive, local, plant"):
        LaneGroup(rig, {})


def test_a_rig_that_limits_what_it_receives_is_not_for_lanes() -> None:
    path = ROOT / "plants/atb1000/rigs/hull.yaml"
    text = f"base: {path}\nrig: limited\n"
    text += "executive: {plausible: {FB_A.encoder: {high: 1}}}\n"
    with pytest.raises(NotInLanes, match="it limits what it receives"):
        LaneGroup(load_rig(path.with_name("limited.yaml"), text=text), {})


NOT_FOR_LANES = (
    (
        "y.voltage_V = min(clip(wanted_V, -p.u_max_V, p.u_max_V), 9.0)",
        "controller: .*pid.py:72: .* no min",
    ),
    ("y.voltage_V = clip(wanted_V, -p.u_max_V, 9.0 if x.integral_V > 2.0 else 8.0)", "differ"),
)


@pytest.mark.parametrize(("line", "reason"), NOT_FOR_LANES)
def test_a_step_that_is_not_for_lanes_is_named(line: str, reason: str, tmp_path: Path) -> None:
    folder = tmp_path / "motor"
    shutil.copytree(ROOT / "tools/make/template", folder)
    law, old = folder / "laws/pid.py", "y.voltage_V = clip(wanted_V, -p.u_max_V, p.u_max_V)"
    text = law.read_text()
    assert text.count(old) == 1
    law.write_text(text.replace(old, line))
    rig = load_rig(folder / "rig.yaml")
    with pytest.raises((NotInLanes, LanesDiffer), match=reason):
        group = LaneGroup(rig, {})
        group.begin()
        place = group.plans["executive"].names.index("controller.ki_V_rads")
        group.put(2, "executive", {place: 900.0})
        group.run()


def test_a_hand_over_in_lanes_has_the_bits_of_single_runs() -> None:
    schedule = "schedule=[{at_s: 0.1, handover: pd_nn_fast}, {at_s: 0.2, handover: pd_nn}]"
    settings = ["duration_s=0.3", "standby=[pd_nn_fast]", "handover.over_s=0.05", schedule]
    rig = load_rig(ROOT / "plants/atb1000/rigs/hull.yaml", "pd_nn", settings)
    names = wanted(rig)
    group = LaneGroup(rig, names)
    group.begin()
    values = [moved(group, lane) for lane in range(WIDTH)]
    made = group.plans["executive"]
    for lane, own in enumerate(values):
        for kept, _ in standby_copies(made.spec, made.table):
            own["executive"].pop(kept, None)
        for role, one in own.items():
            group.put(lane, role, one)
        for kept, state in standby_copies(made.spec, made.table):
            own["executive"][kept] = own["executive"].get(state, made.values[state])
    assert not group.run().any()
    for lane in (0, WIDTH - 1):
        log = alone(rig, values[lane])
        assert differences(log, group, names, lane) == []
        in_charge = log.node["executive"].columns["handover.in_charge"]
        assert [*np.flatnonzero(np.diff(in_charge))] == [99, 199]
