"""All parts of a node, in the order of its table: logs, old ones too, name variables by place.

A feature is one line here: without it, a node has neither its variables nor what the loop needs.
"""

from pcpc.executive.nodes.fmus import Fmus
from pcpc.executive.nodes.part import Part
from pcpc.executive.nodes.planned_blocks import Blocks
from pcpc.executive.nodes.planned_commands import Commands
from pcpc.executive.nodes.planned_drive import PlantDrive
from pcpc.executive.nodes.planned_faults import Faults
from pcpc.executive.nodes.planned_frames import FrameRows, Frames
from pcpc.executive.nodes.planned_intrusion import Intrusion
from pcpc.executive.nodes.planned_keyframes import Keyframes
from pcpc.executive.nodes.planned_losses import Losses
from pcpc.executive.nodes.planned_meeting import Meeting
from pcpc.executive.nodes.planned_names import Names, Sources
from pcpc.executive.nodes.planned_overrun import OverrunPolicy
from pcpc.executive.nodes.planned_plausible import Plausible
from pcpc.executive.nodes.planned_run import OwnVariables, Pace
from pcpc.executive.nodes.planned_schedule import Schedule
from pcpc.executive.nodes.planned_supervisor import Supervisor
from pcpc.executive.nodes.planned_wiring import Wiring

PARTS: tuple[Part, ...] = (
    Pace(),
    OwnVariables(),
    Frames(),
    Meeting(),
    Losses(),
    Supervisor(),
    OverrunPolicy(),
    Intrusion(),
    Blocks(),
    Plausible(),
    PlantDrive(),
    Wiring(),
    Commands(),
    Schedule(),
    Faults(),
    Names(),
    Sources(),
    FrameRows(),
    Fmus(),
    Keyframes(),
)
