"""The bus of a rig: its load, response times, an emulated line."""
