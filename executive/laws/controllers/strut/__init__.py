"""Laws of the quarter car's strut."""
