"""The nodes of a rig: executive and plant, and between them a local node where a rig has one.

    two nodes      executive <-- bus --> plant
    three nodes    executive <-- bus --> local <-- local bus --> plant

To the executive the local node is the plant: its SYNC starts the local node's cycle. To the plant
it is the executive. Both buses use one DBC file, whose ids are unique.
"""

from typing import Literal

Role = Literal["executive", "local", "plant"]
ROLES: tuple[Role, ...] = ("executive", "local", "plant")
