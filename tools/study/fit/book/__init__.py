"""Studies of the book about identification."""
