"""Function approximators of the book, as compiled functions on views; family.py: one interface."""
