"""Laws of the arm with an unknown payload."""
