"""A rig in lockstep on real buses: executive in this process, every other node in a forked one.

A fork has all compiled code already, so a run takes a fraction of a second where `pcpc run` takes
three to start; the loop, the sockets and the frames are the same.
"""

import os
import signal
import threading
import time
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import bus as buses
from pcpc.executive.log.reader import Log
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.loop.running import run
from pcpc.executive.nodes.install import install
from pcpc.executive.nodes.plan import describe, plan
from pcpc.executive.nodes.process import open_buses
from pcpc.executive.nodes.virtual import Memory, VirtualRun
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role

RUN_S = 120.0


@dataclass(frozen=True)
class Whole:
    """A run: its records, and all that went into the rings of frames and events, by node."""

    log: Log
    frames: dict[str, NDArray[np.int64]]
    events: dict[str, NDArray[np.int64]]


def whole(blocks: Mapping[str, sh.NodeMemory], log: Log) -> Whole:
    """Return what the rings of a short run still hold beside its records."""
    rings: list[dict[str, NDArray[np.int64]]] = []
    for ring in ("frame", "event"):
        puts = {role: int(block.ends(ring).head) for role, block in blocks.items()}
        assert all(put <= len(blocks[role][ring]) for role, put in puts.items()), puts
        rings.append({role: block[ring][: puts[role]].copy() for role, block in blocks.items()})
    return Whole(log, *rings)


def differing(a: Whole, b: Whole) -> list[str]:
    """Return the variables and rings of which two runs hold other bits."""
    one, other = a.log.node, b.log.node
    assert one.keys() == other.keys()
    found = [
        f"{role}: {name}"
        for role in one
        for name, values in one[role].columns.items()
        if not np.array_equal(values.view(np.int64), other[role].columns[name].view(np.int64))
    ]
    for what, ours, theirs in (("frames", a.frames, b.frames), ("events", a.events, b.events)):
        found += [f"{r}: {what}" for r in ours if not np.array_equal(ours[r], theirs[r])]
    return found


def virtual(rig: Rig) -> Whole:
    """Return a run of `rig` in virtual time."""
    run = VirtualRun(rig, None)
    for _ in run.advance():
        pass
    return whole(dict(zip(rig.roles, run.blocks, strict=True)), run.memory.log())


def lockstep(rig: Rig, bus_name: str) -> Whole:
    """Return a run of `rig` on `bus_name`; AssertionError if it does not end."""
    bus = buses.bus_named(*buses.parse(bus_name))
    plans = {role: plan(rig, role, "lockstep") for role in rig.roles}
    metadata = {"pacing": "lockstep"}
    blocks = {}
    for role, made in plans.items():
        served = sharing.ServedMemory(role, describe(made, metadata))
        blocks[role] = served.block
        served.close()

    def node(role: Role) -> None:
        loop = blocks[role].loop
        open_buses(rig, bus, plans[role], loop.wire)
        install(plans[role], loop)
        loop.rx.listen_ns = 0
        run(loop, plans[role].steps)

    children = []
    for role in rig.roles[1:]:
        with warnings.catch_warnings():  # the other thread waits, without a lock
            warnings.simplefilter("ignore", DeprecationWarning)
            children.append(os.fork())
        if children[-1] == 0:
            with suppress(BaseException):
                node(role)
            os._exit(0)
    executive = threading.Thread(target=node, args=("executive",), daemon=True)
    executive.start()
    memory = Memory(list(blocks.values()))
    end_s = time.monotonic() + RUN_S
    while children:
        children = [child for child in children if os.waitpid(child, os.WNOHANG)[0] == 0]
        memory.drain()
        executive.join(0.005)
        if time.monotonic() > end_s:
            for child in children:
                os.kill(child, signal.SIGKILL)
            raise AssertionError(f"{rig.config.rig}: no end after {RUN_S:g} s")
    executive.join()
    memory.drain()
    return whole(blocks, memory.log())
