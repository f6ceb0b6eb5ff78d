"""Hardware-in-the-loop in Python: a compiled real-time executive and a plant emulator on CAN."""
