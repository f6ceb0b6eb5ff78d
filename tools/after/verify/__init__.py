"""Many logs recomputed, and a table that says what each of them is."""
