"""A rig in lockstep on real buses: executive in this process, every other node in a forked one.

A fork has all compiled code already, so a run takes a fraction of a second where `pcpc run` takes
three to start; the loop, the sockets and the frames are the same.
"""

import os
import signal
import threading
import time
from contextlib import suppress

from drivers import bus as buses
from executive import shared as sh
from executive.cycle import run
from executive.install import install
from executive.logs import Log
from executive.node import describe, plan
from executive.process import open_buses
from executive.rig import Rig
from executive.roles import Role
from executive.virtual import Memory

RUN_S = 120.0


def lockstep(rig: Rig, bus_name: str) -> Log:
    """Return the records of a run of `rig` on `bus_name`; AssertionError if it does not end."""
    bus = buses.choose(*buses.parse(bus_name))
    plans = {role: plan(rig, role, "lockstep") for role in rig.roles}
    metadata = {"pacing": "lockstep"}
    blocks = {
        role: sh.create(sh.block_name(rig.config.rig, bus_name, role), describe(made, metadata))
        for role, made in plans.items()
    }
    for block in blocks.values():
        block.unlink()

    def node(role: Role) -> None:
        loop = blocks[role].loop
        open_buses(rig, bus, plans[role], loop.wire)
        install(plans[role], loop)
        run(loop, plans[role].steps)

    children = []
    for role in rig.roles[1:]:
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
    return memory.log()
