"""Python as machine code: how it is compiled and kept, and what compiled code can name."""
