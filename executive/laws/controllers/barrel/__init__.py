"""Laws of the flexible barrel."""
