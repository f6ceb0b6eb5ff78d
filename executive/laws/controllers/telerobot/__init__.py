"""Laws of both sides of the telerobot."""
