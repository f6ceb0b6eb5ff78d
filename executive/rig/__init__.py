"""The rig file: read, checked, its laws found and tried."""
