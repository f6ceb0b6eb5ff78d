"""Received values that cannot be true: each limit, what is taken instead, fault, false alarm."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from engine import ATB1000, Bench, Node, both
from replays import replayed

from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.plausibility import WHYS, take_plausible
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import in_memory, simulate
from pcpc.executive.rig.reading import Rig, load_rig

HULL, ENCODER = ATB1000 / "rigs/hull.yaml", "FB_A.encoder"
COUNT = f"health.implausible.{ENCODER}"


def rig_with(limits: str, more: str = "", name: str = ENCODER, role: str = "executive") -> Rig:
    """Return the barrel on its hull with limits of a signal that a node receives."""
    text = f"base: {HULL}\nrig: limited\nduration_s: 0.3\nevaluation: null\nrequire: []\n"
    text += f"expect: {{}}\n{role}: {{plausible: {{{name}: {{{limits}}}}}}}\n{more}"
    return load_rig(HULL.with_name("limited.yaml"), text=text)


def fault(kind: str, at: str = "plant:tx.FB_A.encoder") -> str:
    """Return the rig's entry of a fault that acts from cycle 100 on, for 2 cycles."""
    return f'faults: {{it: {{{kind}, at: "{at}", from: 100ms, for: 2ms}}}}\n'


@pytest.fixture(scope="module")
def node() -> Node:
    """Return an executive that limits the encoder: 1 rad, 0.01 rad a cycle, 5 cycles; 4 fault."""
    rig = rig_with("low: -1, high: 1, rate_per_s: 10, still_cycles: 5, fault_after: 4")
    return Bench(both(rig)).executive


def taken(node: Node, values: Sequence[float], first: int = 0) -> list[float]:
    """Return what stands in the table after each of some values, one a cycle."""
    n, place, found = node.loop, node.place(f"rx.{ENCODER}"), []
    row = int(n.plausible.row[0])
    n.plausible.taken_at[0], n.plausible.came[0], n.plausible.in_a_row[0] = -1, math.nan, 0
    n.guard.faulted, n.v[node.place(COUNT)] = Fault.NONE, 0.0
    for n.k, value in enumerate(values, first):
        n.v[place] = value
        take_plausible(n, row)
        found.append(float(n.v[place]))
    return found


@pytest.mark.parametrize(
    ("values", "wanted", "why"),
    [
        ([0.9921875, 1.0, 1.001, 1.0], [0.9921875, 1.0, 1.0, 1.0], "outside of its bounds"),
        ([-0.9921875, -1.0, -1.001, -1.0], [-0.9921875, -1.0, -1.0, -1.0],
         "outside of its bounds"),
        ([0.0, math.nan, 0.01], [0.0, 0.0, 0.01], "no finite number"),
        ([0.0, math.inf, -math.inf, 0.01], [0.0, 0.0, 0.0, 0.01], "no finite number"),
        ([0.0, 0.0078125, 0.0625], [0.0, 0.0078125, 0.0078125], "too fast"),
        ([0.0, -0.0625], [0.0, 0.0], "too fast"),
        ([1.5, 0.5], [0.0, 0.5], "outside of its bounds"),
    ],
)  # fmt: skip
def test_what_is_not_plausible_is_not_taken_and_the_last_value_stays(
    node: Node, values: list[float], wanted: list[float], why: str
) -> None:
    assert taken(node, values) == wanted
    assert WHYS.index(why) > 0 and node[COUNT] == sum(
        a != b for a, b in zip(values, wanted, strict=True)
    )


def test_a_signal_may_have_moved_for_as_long_as_it_was_not_taken(node: Node) -> None:
    assert taken(node, [0.0, 0.0234375, 0.02, 0.0234375]) == [0.0, 0.0, 0.02, 0.0234375]


def test_the_second_frame_of_a_cycle_may_move_as_far_as_in_a_cycle(node: Node) -> None:
    n = node.loop
    assert taken(node, [0.0, 0.0078125]) == [0.0, 0.0078125]
    for value, wanted in ((0.015625, 0.015625), (0.03125, 0.015625)):
        n.v[node.place(f"rx.{ENCODER}")] = value
        take_plausible(n, n.plausible.row[0])
        assert node[f"rx.{ENCODER}"] == wanted


def test_a_value_may_stand_still_for_as_long_as_the_rig_says(node: Node) -> None:
    taken(node, [0.25] * 6)
    assert node[COUNT] == 0 and node.loop.guard.faulted == Fault.NONE
    taken(node, [0.25] * 7)
    assert node[COUNT] == 1
    taken(node, [0.25] * 7 + [0.2578125] * 6)
    assert node[COUNT] == 1, "it moves again"


def test_only_values_in_a_row_are_a_fault_that_says_which_and_why(node: Node) -> None:
    taken(node, [0.0, 2.0, 2.0, 2.0, 0.0, 2.0, 2.0, 2.0])
    assert node.loop.guard.faulted == Fault.NONE and node[COUNT] == 6
    taken(node, [0.0, 2.0, 2.0, 2.0, -3.0], first=20)
    control = node.loop.control
    assert node.loop.guard.faulted == Fault.NOT_PLAUSIBLE
    assert WHYS[control.culprit] == "outside of its bounds"
    assert control.odd_place == node.place(f"rx.{ENCODER}") + 1 and control.odd_cycle == 24
    assert control.odd_bits.view(np.float64) == -3.0


def test_a_frame_is_no_input_until_its_limited_signals_were_taken_once(node: Node) -> None:
    n, row = node.loop, int(node.loop.plausible.row[0])
    n.plausible.taken_at[0] = -1
    n.v[node.place(f"rx.{ENCODER}")] = 7.0
    assert not take_plausible(n, row) and take_plausible(n, row + 1)
    n.v[node.place(f"rx.{ENCODER}")] = 0.5
    assert take_plausible(n, row)


@pytest.mark.parametrize(
    ("limits", "kind"),
    [
        ("low: -0.5, high: 0.5", "kind: bias, value: 0.6"),
        ("rate_per_s: 2", "kind: bias, value: 0.1"),
        ("rate_per_s: 2", "kind: noise, value: 0.1"),
    ],
)
def test_a_wrong_sensor_is_held_off_in_the_cycle_in_which_it_is_wrong(
    limits: str, kind: str
) -> None:
    log = in_memory(rig_with(limits, fault(kind)))
    columns = log.node["executive"].columns
    heard, counts = columns[f"rx.{ENCODER}"], columns[COUNT]
    assert abs(heard).max() < 0.05, "nothing of it was taken"
    assert list(counts[98:104]) == [0, 0, 1, 2, 2, 2], counts[98:104]
    assert columns["supervisor.fault"].max() == Fault.NONE


def test_without_the_limits_the_same_sensor_is_believed() -> None:
    log = in_memory(rig_with("fault_after: 9", fault("kind: bias, value: 0.6")))
    assert abs(log.node["executive"].columns[f"rx.{ENCODER}"]).max() > 0.5


def test_the_plant_does_not_take_a_forged_command() -> None:
    more = "faults: {it: {kind: masquerade, frame: CMD, from: 100ms, for: 5ms}}\n"
    rig = rig_with("rate_per_s: 500", more, "CMD.motor_torque", "plant")
    columns = in_memory(rig).node["plant"].columns
    assert columns["health.implausible.CMD.motor_torque"].max() >= 3
    assert abs(columns["rx.CMD.motor_torque"]).max() < 0.5, "drawn torques are up to 30 N m"


def test_the_fault_is_recorded_told_and_replayed_to_the_bit(tmp_path: Path) -> None:
    rig = rig_with("rate_per_s: 2", fault("kind: bias, value: 0.6").replace("2ms", "50ms"))
    path = tmp_path / "log.mcap"
    run = simulate(rig, path)
    assert run.blocks[0].control.fault == Fault.NOT_PLAUSIBLE
    seen = replayed(path)
    assert len(seen) == 2 and all(one.identical for one in seen), seen
    told = [
        event
        for event in logs.read(path).node["executive"].events
        if event["event"] == "implausible"
    ]
    assert [one["name"] for one in told] == [f"rx.{ENCODER}"] and told[0]["cycle"] == 100


@pytest.mark.parametrize(
    ("name", "limits", "what"),
    [
        ("FB_A.encodr", "low: 0", "EXEC receives no signal FB_A.encodr; did you mean FB_A.encoder"),
        ("CMD.motor_torque", "low: 0", "EXEC receives no signal CMD.motor_torque"),
        (ENCODER, "low: 1, high: -1", "low 1 is not below high -1"),
        (ENCODER, "low: .nan", ".nan is not a value"),
        (ENCODER, "low: 50", "no value of FB_A.encoder, "),
        (ENCODER, "rate_per_s: .inf", "rate_per_s: expected a finite number, got inf"),
        (ENCODER, "rate_per_s: .nan", ".nan is not a value"),
        (ENCODER, "rate_per_s: 0", "rate_per_s: expected a number > 0.0, got 0"),
        (ENCODER, "still_cycles: 0", "still_cycles: expected a whole number >= 1, got 0"),
        (ENCODER, "fault_after: 0", "fault_after: expected a whole number >= 1, got 0"),
        (ENCODER, "hi: 3", "hi: unknown key; did you mean high?"),
    ],
)  # fmt: skip
def test_wrong_limits_are_told_with_their_place(name: str, limits: str, what: str) -> None:
    with pytest.raises(RigError) as error:
        plan(rig_with(limits, name=name), "executive", "virtual")
    text = str(error.value)
    assert "limited.yaml:7:" in text and what in text
    assert f"executive.plausible.{name}" in text or ".nan" in limits


@pytest.mark.parametrize("controller", ["pd", "pd_nn_fast"])
def test_limits_with_room_refuse_nothing_of_a_clean_run(controller: str) -> None:
    limits = "low: -0.2, high: 0.2, rate_per_s: 1, still_cycles: 200"
    rig = rig_with(limits, "duration_s: 6.0\n".replace("duration_s", "seed: 2 #"))
    rig = load_rig(rig.path, controller, ["duration_s=6"], text=rig.document.sources[rig.path])
    assert in_memory(rig).node["executive"].columns[COUNT].max() == 0.0
