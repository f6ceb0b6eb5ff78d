"""Whether a CAN adapter is good enough."""
