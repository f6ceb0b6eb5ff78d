"""The nodes of a rig: executive and plant, and between them a local node where a rig has one.

    two nodes      executive <-- bus --> plant
    three nodes    executive <-- bus --> local <-- local bus --> plant
    more plants    executive <-- bus --> plant, plant_2, ...; some may be on a second bus

To the executive the local node is the plant: its SYNC starts the local node's cycle. To the plant
it is the executive. Both buses use one DBC file, whose ids are unique.
"""

from typing import Literal, get_args

Role = Literal[
    "executive", "local", "plant", "plant_2", "plant_3", "plant_4", "plant_5", "plant_6",
    "plant_7", "plant_8", "plant_9", "plant_10", "plant_11", "plant_12", "plant_13", "plant_14",
    "plant_15", "plant_16",
]  # fmt: skip
ROLES: tuple[Role, ...] = get_args(Role)
PLANTS = ROLES[2:]  # `plant` and those beside it
MORE_PLANTS = PLANTS[1:]
