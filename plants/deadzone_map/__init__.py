"""A second-order difference equation behind a deadzone, of chapter 4 of the book."""
