"""The supervisor of a node: how long an input is held, how fast it ramps down, who stops it."""

from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.variables import DISARMED
from pcpc.executive.nodes.part import Part, Plan
from pcpc.executive.rig import messages as protocol
from pcpc.executive.rig.reading import Rig


class Supervisor(Part):
    """What a node does without input, on a fault, and when it is stopped; who arms it."""

    def variables(self, made: Plan) -> None:
        """Check the emergency stop and the stop frame; RigError for one that no node hears."""
        with protocol.errors_named(made.rig):
            protocol.check_stops(made.rig, protocol.database_of(made.rig))

    def in_no_lane(self, rig: Rig) -> str:
        """Return that an operator arms it."""
        return "it is armed by hand" if rig.config.supervisor.arm == "manual" else ""

    def install(self, made: Plan, loop: Loop) -> None:
        """Write the rig's `supervisor`, and where the wishes to stop come from."""
        guard, wanted, index = loop.guard, made.rig.config.supervisor, made.table.index
        period_s = loop.clock.period_ns * 1e-9
        guard.hold_cycles = wanted.hold_cycles
        guard.fault_after = wanted.fault_after_cycles
        guard.waits = wanted.on_fault == "wait"
        guard.ramp_step = period_s / wanted.ramp_s
        guard.quick_step = period_s / (wanted.quick_stop_s or wanted.ramp_s)
        guard.safe_start = made.leads
        guard.odd_output = Fault.PLANT_NOT_FINITE if made.is_plant else Fault.OUTPUT_NOT_FINITE
        guard.manual = made.leads and wanted.arm == "manual"
        guard.gain, guard.disarmed = 1.0 - guard.manual, guard.manual
        loop.v[DISARMED] = guard.manual
        guard.estop_index = index.get(f"rx.{wanted.estop}", -1)
        names = [frame.name for frame in made.rx_frames]
        guard.stop_row = names.index(wanted.stop_frame) if wanted.stop_frame in names else -1
        modes = [
            index[f"rx.{frame.name}.mode"]
            for frame in made.rx_frames
            if frame.name not in made.below and any(s.name == "mode" for s in frame.signals)
        ]
        guard.mode_index = modes[0] if modes and not made.leads else -1
