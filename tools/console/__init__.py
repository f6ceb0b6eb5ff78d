"""The command line: commands and what they take, how they end, text for a terminal."""
