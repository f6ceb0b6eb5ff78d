"""A step of a law, from its syntax tree to C99: kinds, expressions, statements, functions."""
