"""Laws of the arm with friction."""
