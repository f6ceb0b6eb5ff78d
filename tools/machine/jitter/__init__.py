"""The timing of the loop, measured."""
