"""A CAN bus on one machine, bit by bit: arbitration, stuffing, error frames, time."""
