"""An independent watch of a run, from its bus alone."""
