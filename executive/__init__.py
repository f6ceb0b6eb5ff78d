"""The engine (cycle, table, blocks) and what steers it: rig file, supervisor, recorder, virtual time."""
