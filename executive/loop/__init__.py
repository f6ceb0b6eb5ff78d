"""The loop: its cycle, its memory, and what each part of a cycle does."""
