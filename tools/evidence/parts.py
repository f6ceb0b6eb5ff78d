"""The parts of the evidence, in their order."""

PARTS = ("matrix", "residual", "alarms", "mutants", "kills")
