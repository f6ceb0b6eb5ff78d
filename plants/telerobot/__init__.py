"""A two-link arm behind a node of its own, steered over a delay."""
