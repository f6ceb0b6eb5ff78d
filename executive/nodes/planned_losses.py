"""The rig's losses of frames on purpose, at the receivers in a node."""

from pcpc.executive.loop import losses
from pcpc.executive.loop.layout import Loop
from pcpc.executive.nodes.part import Part, Plan
from pcpc.executive.rig import messages as protocol
from pcpc.executive.rig.reading import Rig


class Losses(Part):
    """Frames that a node does not receive, singly or in bursts."""

    def variables(self, made: Plan) -> None:
        """Check them; they have no variables. RigError for a frame that cannot be lost."""
        if made.rig.config.losses:
            with protocol.errors_named(made.rig):
                _check(made.rig)

    def install(self, made: Plan, loop: Loop) -> None:
        """Write share and burst of each frame, and where its generator begins."""
        config = made.rig.config
        shares = {name: (loss.share, loss.burst) for name, loss in config.losses.items()}
        losses.install(loop, made.rx_frames, shares, config.seed)


def _check(rig: Rig) -> None:
    """Raise RigError for losses of a frame that is not there, or that starts cycles."""
    frames = protocol.frames_of_rig(rig, protocol.database_of(rig))
    beats = [frame.name for frame in frames if protocol.is_heartbeat(frame)]
    awaited = [frame.name for frame in frames if protocol.is_awaited(frame)]
    names = [name for name in awaited if name not in beats]
    for name in rig.config.losses:
        if name not in names and any(frame.name == name for frame in frames):
            why = "a heartbeat, for which the start waits" * (name in beats)
            what = f"{name} is {why or 'not sent every cycle'}; losses work on {', '.join(names)}"
            raise rig.error(f"losses.{name}", what)
        rig.known(f"losses.{name}", name, names, "frame")
