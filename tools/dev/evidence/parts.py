"""The parts of the evidence, in their order."""

PARTS = ("matrix", "residual", "frames", "envelope", "alarms", "mutants", "kills")
