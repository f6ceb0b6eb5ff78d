"""The engine (cycle, table, blocks) and what steers it: rig file, recorder, virtual time."""
