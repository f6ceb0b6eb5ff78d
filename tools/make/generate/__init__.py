"""C from laws: `pcpc generate c`."""
