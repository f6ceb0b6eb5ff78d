"""The two-link arm: what the systems with two links share."""
