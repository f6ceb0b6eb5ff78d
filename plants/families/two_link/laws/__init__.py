"""Laws of every two-link arm."""
