"""Logs: written by the recorder, read back, also damaged or long ones."""
