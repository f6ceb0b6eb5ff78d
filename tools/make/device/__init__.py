"""`pcpc run RIG --device`: a device in the executive's place, recorded and judged.

cli         the command: a folder, a run, a verdict
host        the processes: emulator, recorder, the device's own command
record      the plant's record as the log of a run, for what judges runs
behaviour   what the device did on the bus: counters, CRC, rate, lateness, silence, restart
"""
