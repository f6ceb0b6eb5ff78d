"""CAN: ids, buses, DBC files, signals in frames, counters and CRC, and a line as a model."""
