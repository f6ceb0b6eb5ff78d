"""Laws of the pendulum with backlash."""
