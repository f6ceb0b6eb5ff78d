"""Actuator nonlinearities as compiled functions: friction, gear play, drive limits."""
