"""Studies of the book that need no rig."""
