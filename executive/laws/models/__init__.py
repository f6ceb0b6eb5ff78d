"""Mechanics that a plant is and that a law may know: one source of the equations for both."""
