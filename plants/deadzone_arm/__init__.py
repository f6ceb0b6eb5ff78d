"""A planar two-link arm with a deadzone in front of each joint, of chapter 4 of the book."""
