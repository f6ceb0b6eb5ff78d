"""Laws of the gun barrel."""
