"""Laws of the arm with deadzones."""
