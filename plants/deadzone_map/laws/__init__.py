"""Laws of the map with a deadzone."""
