"""Controllers on standby: one takes over from another without a step, on the record, or not at all.

The identities are those of `executive.laws.handover`: (1) and (2) to the last bit, and nothing of a
run changes by somebody who only stands by.
"""

from pathlib import Path

import numpy as np
import pytest
from engine import ATB1000, ROOT, Bench, both, puppet_rig
from numpy.typing import NDArray
from replays import replayed

from pcpc.executive.errors import RigError
from pcpc.executive.log.reader import NodeLog
from pcpc.executive.loop.faults import Fault
from pcpc.executive.nodes.plan import check_pacing, plan
from pcpc.executive.nodes.virtual import in_memory, simulate
from pcpc.executive.rig.reading import load_rig

HULL = ATB1000 / "rigs" / "hull.yaml"
TORQUE = "controller.motor_torque_Nm"
SENT = "tx.CMD.motor_torque"
OTHERS = """\
from pcpc.executive.laws.block import Block, Ports, port, stage
from pcpc.executive.laws.emath import NAN, where
from pcpc.plants.atb1000.laws import pd


class Settings(Ports):
    torque_Nm = port("N m", "what is sent", 0.0, -1e9, 1e9)
    void = port("", "1: no number is sent", 0.0, 0.0, 1.0)


class States(Ports):
    steps = port("", "how often it was stepped")
    learned = port("", "how often while it was in charge", adapts=True)


class Speed(Ports):
    speed = port("", "another output")


@stage
def step(t: float, dt: float, p: Settings, x: States, u: pd.Inputs, y: pd.Outputs) -> None:
    y.motor_torque_Nm = where(p.void > 0.5, NAN, p.torque_Nm)
    y.tau_Nm = x.learned
    y.e_rad = u.q_d_rad
    y.r_rad_s = 0.0
    x.steps += 1.0
    x.learned += 1.0


@stage
def other(t: float, dt: float, p: Settings, x: States, u: pd.Inputs, y: Speed) -> None:
    y.speed = 0.0


BLOCK, OTHER = Block(step), Block(other)
"""


def two(folder: Path, *lines: str) -> Path:
    """Write a rig of a puppet and of two others, of which `second` is on standby."""
    (folder / "others.py").write_text(OTHERS)
    path = puppet_rig(folder, *lines)
    entry = "{puppet: {law: others.py}, second: {law: others.py}, third: {law: others.py}, "
    entry += 'lean: {law: "others.py:OTHER"}}'
    text = path.read_text().replace("{puppet: {law: puppet.py}}", entry)
    path.write_text(text + ("" if "standby:" in text else "standby: [second]\n"))
    return path


def bench(folder: Path, *lines: str, over_s: float = 0.0) -> Bench:
    """Return a bench of both nodes past their meeting: the puppet sends 1.5, `second` -0.5 N m."""
    rig = load_rig(two(folder, *lines), settings=[f"handover.over_s={over_s}"])
    made = Bench(both(rig))
    made.executive["controller.torque_Nm"], made.executive["second.torque_Nm"] = 1.5, -0.5
    made.run(20)
    assert made.executive.state == "RUN"
    return made


def course(made: Bench, cycles: int, name: str = SENT) -> list[float]:
    """Return a variable of the executive in the next cycles."""
    found = []
    for _ in range(cycles):
        made.run(1)
        found.append(made.executive[name])
    return found


def bits(values: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.ascontiguousarray(values).view(np.int64)


def test_the_step_fades_along_a_line_and_is_gone_to_the_last_bit(tmp_path: Path) -> None:
    made = bench(tmp_path, over_s=0.02)
    made.executive["handover.to"] = 1.0
    found = course(made, 40)
    wanted = -0.5 + 2.0 * np.clip(1.0 - np.arange(40) / 20, 0.0, 1.0)
    assert np.abs(np.array(found) - wanted).max() < 1e-12, found
    assert found[0] == 1.5 and found[21:] == [-0.5] * 19
    assert made.executive["handover.in_charge"] == 1.0


def test_a_hand_over_within_a_hand_over_has_no_step_either(tmp_path: Path) -> None:
    made = bench(tmp_path, over_s=0.02)
    made.executive["handover.to"] = 1.0
    before = course(made, 11)[-1]
    made.executive["handover.to"] = 0.0
    found = np.array([before, *course(made, 30)])
    assert abs(before - 0.5) < 1e-12, "half of the way"
    assert np.abs(np.diff(found)).max() < 0.1 + 1e-12, "2 N m in 20 cycles is the fastest"
    assert found[-1] == 1.5


def test_without_a_fade_the_rate_limit_of_the_command_stands(tmp_path: Path) -> None:
    limit = "executive: {limits: {CMD.motor_torque: {low: -2, high: 2, rate_per_s: 125}}}"
    made = bench(tmp_path, limit)
    made.executive["handover.to"] = 1.0
    found = np.array([1.5, *course(made, 20)])
    assert made.executive[TORQUE] == -0.5
    assert np.abs(np.diff(found)).max() <= 0.125 and found[-1] == -0.5, found


def test_all_compute_along_and_only_who_is_in_charge_adapts(tmp_path: Path) -> None:
    made = bench(tmp_path)
    node = made.executive
    steps = node["controller.steps"]
    assert node["second.steps"] == steps == node["controller.learned"]
    assert node["second.learned"] == 0.0
    node["handover.to"] = 1.0
    made.run(10)
    assert node["second.learned"] == 10.0 and node["controller.learned"] == steps
    node["handover.to"] = 0.0
    made.run(5)
    assert node["second.learned"] == 10.0 and node["controller.learned"] == steps + 5
    assert node["second.steps"] == node["controller.steps"] == steps + 15


def test_who_says_no_number_stands_by_without_harm_and_cannot_take_over(tmp_path: Path) -> None:
    made = bench(tmp_path)
    node = made.executive
    node["second.void"] = 1.0
    made.run(5)
    assert node.state == "RUN" and node["handover.usable_second"] == 0.0
    node["handover.to"] = 1.0
    made.run(5)
    told = [node[f"handover.{name}"] for name in ("in_charge", "refused", "usable_puppet")]
    assert told == [0.0, 1.0, 1.0] and node[SENT] == 1.5 and node.state == "RUN"
    node["second.void"] = 0.0
    made.run(5)
    assert node["handover.in_charge"] == 0.0, "refused is refused"
    node["handover.to"] = 0.0
    made.run(1)
    node["handover.to"] = 1.0
    made.run(2)
    assert node[SENT] == -0.5
    node["controller.void"] = 1.0
    made.run(5)
    assert node.state == "RUN", "the rig's own controller stands by, too"
    node["second.void"] = 1.0
    made.run(2)
    assert (node.state, node["supervisor.fault"]) == ("FAULT", Fault.COMMAND_NOT_FINITE)


def executive(controller: str, *settings: str) -> NodeLog:
    """Return what the hull's executive recorded in 0.6 s."""
    return in_memory(load_rig(HULL, controller, ["duration_s=0.6", *settings])).node["executive"]


def test_who_only_stands_by_changes_no_bit() -> None:
    alone, beside = executive("pd_nn"), executive("pd_nn", "standby=[pid, pd_nn_fast]")
    changed = [
        name
        for name, values in alone.columns.items()
        if not np.array_equal(bits(values), bits(beside.columns[name]))
    ]
    assert len(alone.cycle) == 600 and not changed, changed


def test_after_the_fade_the_command_is_the_laws_own() -> None:
    node = executive(
        "pd", "standby=[pid]", "handover.over_s=0.1", "schedule=[{at_s: 0.3, handover: pid}]"
    ).columns
    assert np.array_equal(node[TORQUE][:300], node["pd.motor_torque_Nm"][:300])
    assert np.array_equal(node[TORQUE][401:], node["pid.motor_torque_Nm"][401:])
    assert abs(node[TORQUE][300] - node["pd.motor_torque_Nm"][300]) < 1e-15
    integral = node["pid.s_Nm"]
    assert not integral[:300].any() and integral[300:].any(), "it integrates from then on"


def test_a_hand_over_is_on_the_record_and_replayed_bit_for_bit(tmp_path: Path) -> None:
    schedule = "schedule=[{at_s: 0.2, handover: pd_nn}, {at_s: 0.4, handover: pd}]"
    rig = load_rig(HULL, "pd", ["duration_s=0.6", "standby=[pd_nn]", schedule])
    simulate(rig, tmp_path / "log.mcap")
    for verdict in replayed(tmp_path / "log.mcap"):
        assert verdict.identical and verdict.cycles >= 600, (verdict.cycles, verdict.first())


# Rigs by plant. The telerobot's executive has no room for a second law, which keeps its past; with
# three networks of the friction arm it has too few wires.
PLANTS = {
    "atb1000": "hull", "backlash_map": "backlash-map", "backlash_pendulum": "backlash-pendulum",
    "deadzone_arm": "deadzone-step", "deadzone_map": "fuzzy-d03", "friction_arm": "friction-b",
    "map_chains": "two-gaps", "payload_arm": "payload-on", "quarter_car": "suspension-8",
}  # fmt: skip


def taken_over(path: Path, own: str, others: list[str]) -> None:
    """Hand over from `own` to each of `others` and back; every one is in charge, none refused."""
    config = load_rig(path, resolve=False).config
    each, last = 20, len(others)
    moments = [(each * (i + 1), law) for i, law in enumerate([*others, own])]
    told = [f"{{at_s: {at / config.rate_hz}, handover: {law}}}" for at, law in moments]
    settings = [
        f"standby=[{', '.join(others)}]", f"schedule=[{', '.join(told)}]",
        f"duration_s={each * (last + 2) / config.rate_hz}", f"handover.over_s={5 / config.rate_hz}",
    ]  # fmt: skip
    node = in_memory(load_rig(path, own, settings)).node["executive"].columns
    wanted = np.repeat([*range(last + 1), 0], each)
    assert np.array_equal(node["handover.in_charge"][: len(wanted)], wanted)
    assert not node["handover.refused"].any() and not node["supervisor.fault"].any()


@pytest.mark.parametrize(("plant", "name"), PLANTS.items())
def test_the_laws_of_each_plant_take_over_from_each_other(plant: str, name: str) -> None:
    path = ROOT / "plants" / plant / "rigs" / f"{name}.yaml"
    config = load_rig(path, resolve=False).config
    own, *others = sorted(config.controllers)[: 2 if plant == "friction_arm" else 3]
    taken_over(path, own, others)


@pytest.mark.parametrize("others", [["pd_feedforward", "pd_observer"], ["super_twisting", "lqg"]])
def test_the_rivals_of_the_barrel_take_over_from_each_other(others: list[str]) -> None:
    taken_over(HULL, "pd_adaptive", others)


WRONG = {
    "standby: [secnd]": "standby[0]: no controller secnd; did you mean second?",
    "standby: [puppet]": "puppet is the controller itself; remove it",
    "standby: [second, second]": "second is there twice; remove one",
    "standby: [lean]": "lean has no output motor_torque_Nm [N m], which is a command of puppet",
    "standby: [second]\noverrun: {fallback: third}": "overrun.fallback is given too",
    "standby: [second]\nhandover: {to: 2}": "handover.to: 2; expected 0 to 1",
    "standby: [second]\nschedule: [{at_s: 0.1, handover: thrd}]": "thrd is not on standby",
    "standby: []\nschedule: [{at_s: 0.1, handover: second}]": "no controller is on standby",
    "standby: [second]\nschedule: [{at_s: 0.1}]": "give set, handover or both",
}


@pytest.mark.parametrize(("lines", "says"), WRONG.items())
def test_what_cannot_stand_by_is_said_with_its_place(tmp_path: Path, lines: str, says: str) -> None:
    path = two(tmp_path, *lines.split("\n"))
    with pytest.raises(RigError) as caught:
        plan(load_rig(path), "executive", "sync")
    assert says in str(caught.value) and "puppet.yaml:" in str(caught.value), caught.value


def test_who_needs_lockstep_does_not_stand_by_on_a_clock(tmp_path: Path) -> None:
    rig = load_rig(two(tmp_path), settings=["controllers.second.lockstep_only=of a sample"])
    check_pacing(rig, "lockstep")
    with pytest.raises(RigError, match="second does not run in pacing real: of a sample"):
        check_pacing(rig, "real")


def test_settings_of_who_stands_by_are_those_of_the_rig(tmp_path: Path) -> None:
    settings = ["second.torque_Nm=-0.25", "handover.to=1", "duration_s=0.05"]
    node = in_memory(load_rig(two(tmp_path), settings=settings)).node["executive"].columns
    assert (node[SENT][10:] == -0.25).all() and (node["handover.in_charge"] == 1.0).all()
