"""From a rig to a node: every wiring error has its place, every shipped rig is wired completely."""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine import ATB1000, SLEW10, Node, both

from pcpc.executive.errors import RigError
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import Trigger
from pcpc.executive.nodes.plan import Plan, cycles_of, describe, plan
from pcpc.executive.rig.bus_load import check_rate
from pcpc.executive.rig.reading import Rig, load_rig

RIGS = sorted((ATB1000 / "rigs").glob("*.yaml"))
LAWS = """\
from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage

class Passes(Ports):
    passes = port("", "an output")

class Many(Ports):
    s = port("", "too many", shape=9000)

class A(Ports):
    a = port("", "in and out")

@stage
def passes(t, dt, p: Nothing, x: Nothing, u: Nothing, y: Passes): pass

@stage
def huge(t, dt, p: Nothing, x: Many, u: Nothing, y: Nothing): pass

@stage
def pair(t, dt, p: Nothing, x: Nothing, u: A, y: A): pass

PASSES, HUGE, PAIR = Block(passes), Block(huge), Block(pair)
"""
REST = "{law: 'references:step', parameters: {amplitude_rad: 0.0, start_s: 0.0}}"


def rig_of(folder: Path, text: str) -> Rig:
    """Return slew10 with `text` over it, from a folder outside of the project."""
    (folder / "laws.py").write_text(LAWS)
    path = folder / "user.yaml"
    path.write_text(f"base: {SLEW10}\nrig: user\n{text}\n")
    return load_rig(path)


def executive(text: str) -> str:
    """Return `text` as the executive's part."""
    return f"executive:\n  {text}"


def inputs(text: str) -> str:
    """Return `text` as inputs of the controller."""
    return executive(f"blocks:\n    controller:\n      inputs:\n        {text}")


# name: (what is laid over slew10, words of the message, what stands at the place it names)
ERRORS: dict[str, tuple[str, str, str]] = {
    "unknown variable": (
        inputs("encoder_rad: rx.FB_A.encodr"),
        "controller.encoder_rad: no variable 'rx.FB_A.encodr'; did you mean rx.FB_A.encoder?",
        "rx.FB_A.encodr",
    ),
    "another unit": (
        inputs("hub_rate_rad_s: rx.FB_A.encoder"),
        "controller.hub_rate_rad_s is in 'rad/s' but rx.FB_A.encoder is in 'rad'; wire a variable "
        f"of the same unit; or change unit and scale in {SLEW10.parents[1] / 'atb1000.dbc'}:29: n",
        "rx.FB_A.encoder",
    ),
    "a reference in another unit": (
        inputs("hub_rate_rad_s: reference.q_d_rad"),
        "these references are angles; for another unit: law: profiles:step (docs/rig.md)",
        "reference.q_d_rad",
    ),
    "missing input": (
        inputs("encoder_rad: null"),
        "controller.encoder_rad [rad] is not wired: hub angle relative to the hull",
        "",
    ),
    "unknown input": (
        inputs("encodr_rad: rx.FB_A.encoder"),
        "controller has no input encodr_rad; did you mean encoder_rad?",
        "rx.FB_A.encoder",
    ),
    "a variable of the loop": (
        executive("blocks:\n    health: {law: 'laws.py:PASSES'}"),
        "health.passes: two writers: loop and health",
        "health",
    ),
    "two ports of one name": (
        executive("blocks:\n    pair: {law: 'laws.py:PAIR', inputs: {a: health.passes}}"),
        "pair.a: two writers: pair and pair",
        "pair",
    ),
    "a frame of the other node": (
        executive("transmit:\n    FB_A.encoder: controller.e_rad"),
        "EXEC sends no signal FB_A.encoder",
        "controller.e_rad",
    ),
    "an unknown signal": (
        executive("transmit:\n    CMD.motor_torqe: controller.tau_Nm"),
        "EXEC sends no signal CMD.motor_torqe; did you mean CMD.motor_torque?",
        "controller.tau_Nm",
    ),
    "a signal with another unit": (
        executive("transmit:\n    CMD.tau_des: controller.e_rad"),
        "CMD.tau_des is in 'N m' but controller.e_rad is in 'rad'; wire a variable of the same "
        f"unit; or change unit and scale in {SLEW10.parents[1] / 'atb1000.dbc'}:",
        "controller.e_rad",
    ),
    "limits of an unknown signal": (
        executive("limits:\n    CMD.torque: {low: -1.0, high: 1.0}"),
        "EXEC has no such signal CMD.torque",
        "CMD.torque",
    ),
    "limits of a received signal": (
        executive("limits:\n    FB_A.encoder: {low: -1.0, high: 1.0}"),
        "EXEC has no such signal FB_A.encoder",
        "FB_A.encoder",
    ),
    "safe value of an unknown signal": (
        "plant: {safe: {CMD.torque: 0.0}}",
        "PLANT has no such signal CMD.torque",
        "CMD.torque",
    ),
    "safe value of a sent signal": (
        "plant: {safe: {FB_A.encoder: 0.0}}",
        "PLANT has no such signal FB_A.encoder",
        "FB_A.encoder",
    ),
    "too many blocks": (
        executive("blocks:\n" + "\n".join(f"    spare{i}: {REST}" for i in range(7))),
        "9 blocks; one node holds 8",
        "",
    ),
    "too many variables": (
        executive("blocks:\n    huge: {law: 'laws.py:HUGE'}"),
        f"variables; one node holds {sh.MAX_VARIABLES}",
        "",
    ),
    "a rate the plant cannot have": (
        "rate_hz: 1200.0",
        "integrator_hz 16000 is not a whole multiple of the rate 1200 Hz",
        "",
    ),
    "a node that sends no SYNC": (
        executive("node: PLANT\n  transmit: null\n  limits: null"),
        "no SYNC frame from executive to plant",
        "",
    ),
}


@pytest.mark.quick
@pytest.mark.parametrize("name", ERRORS)
def test_an_error_in_the_wiring_begins_with_its_place(tmp_path: Path, name: str) -> None:
    text, words, there = ERRORS[name]
    rig = rig_of(tmp_path, text)
    with pytest.raises(RigError) as caught:
        both(rig)
    message = str(caught.value)
    assert "\n" not in message and words in message, message
    found = re.match(r"(.+?):(\d+):(\d+): ", message)
    assert found, f"no file:line:column: {message}"
    file = Path(found[1])
    line = file.read_text().splitlines()[int(found[2]) - 1]
    if there:
        assert file == tmp_path / "user.yaml", message
        assert there in line and line[int(found[3]) - 1] != " ", f"{message}\nat: {line}"


def test_a_rate_that_the_bus_cannot_carry_is_refused_only_where_a_clock_runs() -> None:
    rig = load_rig(SLEW10, None, ["rate_hz=4000.0"])
    for pacing in ("real", "sync"):
        with pytest.raises(RigError, match=r"rate_hz=4000\.0: 4000 Hz loads the bus with [\d.]+%"):
            check_rate(rig, pacing)
    assert check_rate(rig, "lockstep") > 1.0
    assert check_rate(load_rig(SLEW10, None, ["bus.bitrate=null"]), "real") == 0.0


# ------------------------------------------------------------------------------------ shipped rigs


@pytest.fixture(scope="module")
def plans() -> tuple[Plan, Plan]:
    """Return the plans of slew10."""
    return both(load_rig(SLEW10))


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_every_shipped_rig_fits_one_millisecond_of_bus(path: Path) -> None:
    rig = load_rig(path)
    load = check_rate(rig, "real")
    assert 0.5 < load < 0.9, f"bus load {load:.1%}"
    assert [len(both(rig)[i].spec.blocks) for i in (0, 1)] == [2, 1]


def test_every_input_of_every_block_has_one_source(plans: tuple[Plan, Plan]) -> None:
    for made in plans:
        wanted = sorted(i for views in made.views for i in views.inputs)
        wired = sorted(target for copies in made.copies[:-1] for _, target in copies)
        assert wired == wanted, f"{made.role}: {len(wired)} wires for {len(wanted)} inputs"


def test_a_block_reads_what_stands_before_it_in_the_schedule(plans: tuple[Plan, Plan]) -> None:
    for made in plans:
        order = {spec.block: i for i, spec in enumerate(made.spec.blocks)}
        for spec, copies in zip(made.spec.blocks, made.copies, strict=False):
            writers = {made.table.variables[source].writer for source, _ in copies}
            blocks = [i for i, other in enumerate(made.spec.blocks) if other.name in writers]
            late = [i for i in blocks if i >= order[spec.block]]
            assert not late, f"{spec.name} reads from {[made.spec.blocks[i].name for i in late]}"


def test_frames_are_sent_slow_ones_first_and_SYNC_last(plans: tuple[Plan, Plan]) -> None:
    control, plant = plans
    names = [frame.name for frame in control.tx_frames]
    assert names[-2:] == ["CMD", "SYNC"], names
    assert [frame.name for frame in plant.tx_frames][-3:] == ["FB_A", "FB_B", "FB_C"]
    for made in plans:
        rows = Node(made).loop.tx.frames["can_id"][: len(made.tx_frames)]
        assert rows.tolist() == [frame.can_id for frame in made.tx_frames]


def test_feedback_is_awaited_and_SYNC_starts_the_plant(plans: tuple[Plan, Plan]) -> None:
    control, plant = (Node(made) for made in plans)
    assert (int(control.loop.rx.starters), int(control.loop.rx.awaited)) == (3, 3)
    assert (int(plant.loop.rx.starters), int(plant.loop.rx.awaited)) == (1, 1)


@pytest.mark.parametrize(
    ("pacing", "triggers"),
    [
        ("real", (Trigger.CLOCKED, Trigger.CLOCKED)),
        ("sync", (Trigger.CLOCKED, Trigger.ON_FRAMES)),
        ("lockstep", (Trigger.ON_FRAMES, Trigger.ON_FRAMES)),
    ],
)
def test_the_pacing_says_who_has_a_clock(pacing: str, triggers: tuple[int, int]) -> None:
    nodes = [Node(made) for made in both(load_rig(SLEW10), pacing)]
    assert tuple(int(node.loop.clock.trigger) for node in nodes) == triggers


def test_settings_and_initial_states_stand_in_the_table(plans: tuple[Plan, Plan]) -> None:
    control, plant = (Node(made) for made in plans)
    for spec in plans[0].spec.blocks:
        for name, value in spec.settings.items():
            assert control[f"{spec.name}.{name}"] == value, name
    held, ratio, load = (plant[f"barrel.{n}"] for n in ("x_held_Nm", "gear_ratio", "unbalance_Nm"))
    assert abs(held - load / ratio) < 1e-12, f"the drive holds {held} N m at the start"


def test_limits_ramp_and_counts_come_from_the_rig(tmp_path: Path) -> None:
    rig = rig_of(
        tmp_path,
        "duration_s: 2.5\nrate_hz: 500.0\n"
        "supervisor: {ramp_s: 0.1, hold_cycles: 4, fault_after_cycles: 7}\n"
        + executive("limits: {CMD.motor_torque: {low: -1.0, high: 1.5, rate_per_s: 100.0}}"),
    )
    n = Node(plan(rig, "executive", "sync")).loop
    assert (int(n.guard.hold_cycles), int(n.guard.fault_after), int(n.guard.cycles)) == (4, 7, 1250)
    assert cycles_of(rig) == 1250 and int(n.clock.period_ns) == 2_000_000
    assert math.isclose(float(n.guard.ramp_step), 0.02) and float(n.guard.gain) == 1.0
    assert np.allclose(n.limits.table[0].tolist()[:3], (-1.0, 1.5, 0.2), rtol=1e-12), (
        n.limits.table[0]
    )


def test_the_description_is_json_and_explains_the_record(plans: tuple[Plan, Plan]) -> None:
    for made in plans:
        text = json.dumps(describe(made, {"seed": "1"}))
        described: dict[str, Any] = json.loads(text)
        names = [variable[0] for variable in described["variables"]]
        assert names == made.names and len(set(names)) == len(names)
        columns = described["state_columns"] + described["timing_columns"]
        assert set(columns) <= set(names) and len(set(columns)) == len(columns)
        assert {"rig-resolved.yaml", "atb1000.dbc"} <= set(described["attachments"])
        assert "NaN" not in text


def test_parameters_are_not_recorded_but_have_their_range(plans: tuple[Plan, Plan]) -> None:
    described = describe(plans[0], {})
    assert "controller.kv_Nms_rad" not in described["state_columns"]
    assert described["ranges"]["controller.kv_Nms_rad"] == [0.0, 1000.0]
