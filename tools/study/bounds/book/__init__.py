"""Studies of the book about its theorems."""
