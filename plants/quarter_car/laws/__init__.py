"""Laws of the quarter car."""
