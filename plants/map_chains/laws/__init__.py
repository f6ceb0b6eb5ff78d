"""Laws of the chains."""
