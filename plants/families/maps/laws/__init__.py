"""Laws of every map."""
