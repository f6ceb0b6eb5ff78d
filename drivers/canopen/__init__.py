"""A CANopen drive: CiA 301 on the bus, CiA 402 in its states and modes, with no bus of its own."""
