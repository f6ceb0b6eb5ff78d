"""What parts of a node write by role, pacing and rig: buses, clocks, ramps, sizes of frames."""

from pathlib import Path

import numpy as np
import pytest
from installed import PROBE, loop_of
from places import ROOT

from pcpc.executive.errors import RigError
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import Time, Trigger
from pcpc.executive.nodes import install as installing
from pcpc.executive.nodes import plan as planning
from pcpc.executive.rig.reading import load_rig
from pcpc.executive.rig.roles import Role


def test_a_local_node_listens_and_sends_on_either_bus_to_the_node_that_is_there() -> None:
    rig = load_rig(ROOT / "plants/telerobot/rigs/telerobot-u0.yaml")
    top, made, low = (planning.plan(rig, role, "real") for role in rig.roles)
    for mine, theirs, other in (
        (made.receive_ids, made.receive_ids_below, (top.send_ids, low.send_ids)),
        (made.send_ids, made.send_ids_below, (top.receive_ids, low.receive_ids)),
    ):
        assert set(mine) and set(mine) <= set(other[0]) - set(theirs), "the executive's bus"
        assert set(theirs) and set(theirs) <= set(other[1]), "that of the plant"
    assert made.below and not top.below and not low.receive_ids_below


def test_a_drive_of_can_fd_makes_frames_long_where_the_dbc_file_has_none_of_them() -> None:
    made = planning.plan(load_rig(ROOT / "tests/drivers/robots/moteus.yaml"), "plant", "real")
    assert not any(frame.fd for frame in (*made.rx_frames, *made.tx_frames))
    assert made.fd and made.data_bytes == 64


@pytest.mark.parametrize(("pacing", "clocked", "waits"), [
    ("real", (True, True), 0), ("sync", (True, False), 0), ("lockstep", (False, False), 1),
])  # fmt: skip
def test_a_clock_starts_cycles_and_only_lockstep_waits_for_the_recorder(
    pacing: str, clocked: tuple[bool, bool], waits: int
) -> None:
    roles: tuple[Role, ...] = ("executive", "plant")
    for role, is_clocked in zip(roles, clocked, strict=True):
        n = loop_of(role, pacing)
        assert n.clock.trigger == (Trigger.CLOCKED if is_clocked else Trigger.ON_FRAMES)
        assert n.rings.wait_recorder == waits
        assert n.clock.kind == (Time.LOCKSTEP if waits else Time.REAL)


def test_a_quick_stop_has_a_ramp_of_its_own_if_the_rig_says_so() -> None:
    ramp, quick = "supervisor.ramp_s=0.1", "supervisor.quick_stop_s=0.02"
    for settings, steps in (((ramp,), (0.01, 0.01)), ((ramp, quick), (0.01, 0.05))):
        guard = loop_of("executive", "real", *settings).guard
        assert (guard.ramp_step, guard.quick_step) == pytest.approx(steps)


@pytest.mark.parametrize("text", [
    "record: {keep: 16666min, keyframe: 100ms}", "record: {keyframe: 0s}",
    "record: {keyframe: 16666min}", "faults: {a: {kind: flood, node: plant, value: 200}}",
])  # fmt: skip
def test_what_is_just_possible_is_taken(text: str) -> None:
    assert loop_of("executive", "real", text=text).n_variables


def test_a_stall_needs_a_rig_of_two_nodes() -> None:
    rig = ROOT / "plants/telerobot/rigs/telerobot-u0.yaml"
    text = f"base: {rig}\nrig: more\nfaults: {{a: {{kind: stall, node: plant, for: 1s}}}}\n"
    with pytest.raises(RigError, match="a stall needs a rig of two nodes"):
        planning.plan(load_rig(rig.with_name("more.yaml"), text=text), "executive", "real")


def test_a_stall_of_the_node_above_is_missed_a_cycle_later_and_none_begins_before_the_run() -> None:
    text = f"base: {PROBE}\nrig: more\nfaults: {{a: {{kind: stall, node: executive, %s}}}}\n"
    for moment, cycles in (("from: 50ms, for: 9ms", (49, 50)), ("from: 0s, for: 9ms", (0, 0))):
        rig = load_rig(PROBE.with_name("more.yaml"), text=text % moment)
        plans = [planning.plan(rig, role, "lockstep") for role in rig.roles]
        assert tuple(made.schedule[0][0] for made in plans) == cycles


def test_what_a_plausible_value_may_be_is_counted_in_cycles() -> None:
    limits = "{low: -1, high: 1, rate_per_s: 50}"
    n = loop_of("executive", "real", text=f"executive: {{plausible: {{FB.position: {limits}}}}}")
    assert n.plausible.bounds[0].tolist() == (-1.0, 1.0, 0.05)
    assert n.plausible.still_cycles[0] == 2**62 and n.plausible.fault_after[0] == 10**9


def test_a_local_node_obeys_the_node_above_whatever_one_below_calls_mode(tmp_path: Path) -> None:
    relay = ROOT / "tests/executive/relay"
    signal = ' SG_ mode : 32|4@1+ (1,0) [0|15] "" LOCAL'  # of feedback with the lowest id
    text = (relay / "relay.dbc").read_text().replace("BO_ 288", "BO_ 20").replace(" 288 ", " 20 ")
    lines = text.split("\n")
    at = next(i for i, line in enumerate(lines) if line.startswith("BO_ 20 FB"))
    (tmp_path / "relay.dbc").write_text("\n".join([*lines[: at + 2], signal, *lines[at + 2 :]]))
    rig = (relay / "rig.yaml").read_text().replace("relay.dbc", str(tmp_path / "relay.dbc"))
    made = planning.plan(load_rig(relay / "rig.yaml", text=rig), "local", "real")
    loop = np.recarray(1, sh.LOOP, sh.blank())[0]
    installing.install(made, loop)
    modes = [name for name in made.names if name.startswith("rx.") and name.endswith(".mode")]
    assert modes == ["rx.FB.mode", "rx.ASK.mode"]
    assert made.names[loop.guard.mode_index] == "rx.ASK.mode"
