"""Laws of the two-link arms."""
