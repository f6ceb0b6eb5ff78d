"""Nodes: planned from a rig and run, in processes, in virtual time or from a log."""
