"""A planar two-link arm with smooth friction and a payload, of chapter 7 of the book."""
