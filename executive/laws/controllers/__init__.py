"""The control laws, one file each: pure mathematics, equations in the header."""
