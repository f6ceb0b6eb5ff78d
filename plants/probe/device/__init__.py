"""Two devices in the executive's place beside the probe, in C and in Python, and their rig."""
