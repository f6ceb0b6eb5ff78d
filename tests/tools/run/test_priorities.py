"""Which of a rig's loops go before other programs."""

import os

import pytest
from processes import own_bus

import pcpc

LONG = {
    "duration_s": 1e5, "supervisor.hold_cycles": 10**6, "supervisor.fault_after_cycles": 10**6,
}  # fmt: skip


@pytest.mark.parametrize("pacing", ["lockstep", "real"])
def test_only_a_loop_that_keeps_time_goes_before_other_programs(pacing: str) -> None:
    with pcpc.running("slew10", pacing=pacing, bus=own_bus(), set=LONG) as live:
        for node in (live._node("executive"), live._node("plant")):
            threads = os.listdir(f"/proc/{node.pid}/task")
            policies = {os.sched_getscheduler(int(thread)) for thread in threads}
            assert (os.SCHED_FIFO in policies) == bool(node.block.control.realtime)
            assert pacing == "real" or policies == {os.SCHED_OTHER}
