"""From a rig to a verdict: on a bus, in virtual time, frame by frame."""
