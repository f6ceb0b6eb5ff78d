"""The `pcpc` command and what only people run."""
