"""Function approximators of chapters 1 and 3 of the book; family.py gives them one interface."""
