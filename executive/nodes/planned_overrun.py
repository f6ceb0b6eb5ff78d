"""What follows cycles that take too long: only the executive has a policy."""

from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.supervisor import Overrun
from pcpc.executive.nodes.part import Part, Plan
from pcpc.executive.rig.schema import FALLBACK


class OverrunPolicy(Part):
    """Skipped periods, a fault, or the fallback; the emulator makes up what it owes."""

    def install(self, made: Plan, loop: Loop) -> None:
        """Write the rig's `overrun`."""
        overrun, guard, blocks = made.rig.config.overrun, loop.guard, loop.blocks
        names = [block.name for block in made.spec.blocks]
        blocks.controller = blocks.fallback = -1
        guard.overrun_policy = Overrun.SKIP
        if not made.leads:
            return
        guard.grace_passes = round(overrun.grace_s * made.rig.config.rate_hz)
        if overrun.fault_after is not None:
            guard.overrun_policy, guard.overrun_after = Overrun.FAULT_AFTER, overrun.fault_after
        if overrun.fallback is not None:
            guard.overrun_policy, guard.overrun_after = Overrun.FALL_BACK, overrun.fallback_after
            blocks.controller = names.index("controller")
            blocks.fallback = names.index(FALLBACK)
