"""What parts of a node write by role, pacing and rig: buses, clocks, ramps, sizes of frames."""

from typing import Any

import numpy as np
import pytest
from places import ROOT

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import Time, Trigger
from pcpc.executive.nodes import install as installing
from pcpc.executive.nodes import plan as planning
from pcpc.executive.rig.reading import load_rig
from pcpc.executive.rig.roles import Role

PROBE = ROOT / "plants/probe/rig.yaml"


def loop_of(role: Role, pacing: str, *settings: str, text: str = "") -> Any:
    """Return the LOOP record of a node of the probe with more in its rig."""
    own = f"base: {PROBE}\nrig: more\n{text}\n"
    rig = load_rig(PROBE.with_name("more.yaml"), settings=settings, text=own)
    loop = np.recarray(1, sh.LOOP, sh.blank())[0]
    installing.install(planning.plan(rig, role, pacing), loop)
    return loop


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
