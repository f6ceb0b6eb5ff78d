"""The road not taken: a run that goes on from a cycle of a log, with something changed."""
