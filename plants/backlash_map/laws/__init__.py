"""Laws of the map with backlash."""
