"""Laws of the telerobot."""
