"""Studies of the book about margins."""
