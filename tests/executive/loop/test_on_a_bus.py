"""Nodes in threads of one process on a real bus: they meet, keep time, refuse others."""

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from free_bus import GROUP, own_port
from places import PATIENCE_S, ROOT

from pcpc.drivers.can import bus as buses
from pcpc.executive.loop import faults
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.running import run
from pcpc.executive.loop.states import State
from pcpc.executive.nodes import greeting
from pcpc.executive.nodes.install import install
from pcpc.executive.nodes.plan import describe, plan
from pcpc.executive.nodes.process import open_buses
from pcpc.executive.rig.reading import Rig, load_rig

TEMPLATE = ROOT / "tools/make/template/rig.yaml"
RATE_HZ, CYCLES = 50, 15


class Node:
    """A node on a bus, and the thread that runs it."""

    def __init__(self, rig: Rig, bus: buses.BusAddress, role: Any, pacing: str = "real") -> None:
        made = plan(rig, role, pacing)
        self.block = sh.private(describe(made, {}))
        self.loop, self.control = self.block.loop, self.block.control
        open_buses(rig, bus, made, self.loop.wire)
        install(made, self.loop)
        self.loop.rings.wait_recorder = 0
        self.thread = threading.Thread(target=lambda: run(self.loop, made.steps), daemon=True)

    def start(self) -> "Node":
        self.thread.start()
        return self

    def wait_for(self, what: Callable[[], bool]) -> None:
        """Wait until something is so, or the node has ended."""
        until_s = time.monotonic() + PATIENCE_S
        while not what() and self.thread.is_alive() and time.monotonic() < until_s:
            self.thread.join(0.002)
        assert what()

    def end(self) -> Fault:
        """Return the fault with which it ends."""
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive() and self.control.state == State.STOP
        return Fault(int(self.control.fault))


@pytest.fixture
def bus() -> buses.BusAddress:
    """Return a bus of this test."""
    return buses.bus_named("udp_multicast", f"{GROUP}:{own_port()}")


def motor(*settings: str) -> Rig:
    given = [f"rate_hz={RATE_HZ}", f"duration_s={CYCLES / RATE_HZ}", *settings]
    return load_rig(TEMPLATE, settings=given)


@pytest.mark.parametrize("pacing", ["real", "sync", "lockstep"])
@pytest.mark.quick
def test_two_nodes_meet_and_do_all_cycles(bus: buses.BusAddress, pacing: str) -> None:
    nodes = [Node(motor(), bus, role, pacing) for role in ("plant", "executive")]
    for node in nodes:
        node.start()
        node.wait_for(lambda node=node: node.control.sent > 0)  # type: ignore[misc]
    assert [node.end() for node in nodes] == [Fault.NONE] * 2
    executive = nodes[1].loop
    assert executive.k >= CYCLES and executive.control.foreign == 0
    assert executive.stages[0].count == executive.histogram[0].sum() == executive.passes
    if executive.clock.kind == Time.REAL:
        late_ns = int(executive.stages[0].least)
        period_ns = int(executive.clock.period_ns)
        assert late_ns >= 0, "it never wakes early"
        assert (executive.clock.deadline - executive.clock.phase_ns) % period_ns == 0
        assert executive.control.skipped == executive.k - executive.passes


@pytest.mark.parametrize("role", ["executive", "plant"])
def test_a_second_node_of_a_kind_does_not_begin(bus: buses.BusAddress, role: str) -> None:
    rig = motor(f"duration_s={6000 / RATE_HZ}")
    first = {one: Node(rig, bus, one).start() for one in ("plant", "executive")}
    first["executive"].wait_for(lambda: bool(first["executive"].loop.passes > 2))
    second = Node(rig, bus, role).start()
    assert second.end() == Fault.ANOTHER_SENDER and second.loop.passes == 0
    assert second.control.sent == 0, "its frames are those of the first"
    first["executive"].control.stop = 1
    assert [one.end() for one in first.values()] == [Fault.NONE] * 2
    assert first[role].control.foreign == 0


@pytest.mark.parametrize(("seed", "ends"), [(1, Fault.NONE), (2, Fault.ANOTHER_SENDER)])
def test_a_node_of_another_rig_is_refused_at_the_meeting(
    bus: buses.BusAddress, seed: int, ends: Fault
) -> None:
    nodes = {}
    for role, own in (("plant", 1), ("executive", seed)):
        rig = motor(f"seed={own}")
        nodes[role] = Node(rig, bus, role)
        greeting.install(nodes[role].loop, rig, role)  # type: ignore[arg-type]
    for node in nodes.values():
        node.start()
    found = nodes["executive"].end()
    assert found == ends
    if ends:
        why = faults.reason(nodes["executive"].block.description, nodes["executive"].control)
        assert why.startswith("the other node has another plant")
    nodes["plant"].control.stop = 1
    nodes["plant"].end()


@pytest.mark.parametrize("pacing", ["real", "lockstep"])
@pytest.mark.parametrize("role", ["executive", "plant"])
def test_who_waits_for_nobody_ends_when_it_is_asked(
    bus: buses.BusAddress, role: str, pacing: str
) -> None:
    node = Node(motor(), bus, role, pacing).start()
    ear = buses.listener(bus)
    with ear:
        for _ in range(2):  # it repeats its heartbeat
            ear.settimeout(PATIENCE_S)
            ear.recv(1024)
    node.control.stop = 1
    assert node.end() == Fault.NONE and node.loop.passes <= 1


@pytest.mark.parametrize("when", ["listening", "meeting", "waiting", "closed loop"])
def test_a_bus_that_fails_is_a_fault(bus: buses.BusAddress, when: str) -> None:
    pacing = "lockstep" if when == "waiting" else "real"
    plant, executive = (Node(motor(), bus, one, pacing) for one in ("plant", "executive"))
    if when in ("waiting", "closed loop"):
        plant.loop.guard.cycles = executive.loop.guard.cycles = 10**9
        plant.start()
        executive.start()
        executive.wait_for(lambda: bool(executive.loop.passes > 2))
        executive.loop.wire.fd_rx = -1
    else:
        executive.loop.wire.fd_rx = -1
        executive.loop.rx.listen_ns *= when == "listening"
        executive.start()
    assert executive.end() == Fault.BUS_FAILED and executive.control.bus_errno == 9
    plant.control.stop = 1
    if plant.thread.ident:
        plant.end()
