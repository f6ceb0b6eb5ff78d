"""The edge to the machine: libc, real-time set-up, buses, DBC tables, codec, end-to-end protection.

Imports nothing else of this project.
"""
