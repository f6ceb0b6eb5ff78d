"""`pcpc swarm`: rigs and histories that are drawn, run, and held against what is promised."""
