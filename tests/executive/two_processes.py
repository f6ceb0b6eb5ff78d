"""A rig in lockstep on a real bus: the plant in a forked process, the executive in this one.

A fork has all compiled code already, so a run takes a fraction of a second where `pcpc run` takes
three to start; the loop, the sockets and the frames are the same.
"""

import os
import signal
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

from drivers import bus as buses
from executive import shared as sh
from executive.cycle import run
from executive.install import install
from executive.logs import Log
from executive.node import describe, plan
from executive.rig import Rig
from executive.virtual import Memory

ROLES: Sequence[str] = ("executive", "plant")
RUN_S = 120.0


def lockstep(rig: Rig, bus_name: str) -> Log:
    """Return the records of a run of `rig` on `bus_name`; AssertionError if it does not end."""
    bus = buses.choose(*buses.parse(bus_name))
    plans = {role: plan(rig, role, "lockstep") for role in ROLES}  # type: ignore[arg-type]
    metadata = {"pacing": "lockstep"}
    blocks = {
        role: sh.create(sh.block_name(rig.config.rig, bus_name, role), describe(made, metadata))
        for role, made in plans.items()
    }
    for block in blocks.values():
        block.unlink()

    def node(role: str) -> None:
        loop = blocks[role].loop
        buses.open_bus(bus, plans[role].receive_ids, loop.wire)
        install(plans[role], loop)
        run(loop, plans[role].steps)

    child = os.fork()
    if child == 0:
        with suppress(BaseException):
            node("plant")
        os._exit(0)
    executive = threading.Thread(target=node, args=("executive",), daemon=True)
    executive.start()
    memory = Memory(list(blocks.values()))
    end_s = time.monotonic() + RUN_S
    while os.waitpid(child, os.WNOHANG)[0] == 0:
        memory.drain()
        executive.join(0.005)
        if time.monotonic() > end_s:
            os.kill(child, signal.SIGKILL)
            raise AssertionError(f"{rig.config.rig}: no end after {RUN_S:g} s")
    executive.join()
    memory.drain()
    return memory.log()
