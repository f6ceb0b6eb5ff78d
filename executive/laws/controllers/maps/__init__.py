"""Laws of the maps and the pendulum with play."""
