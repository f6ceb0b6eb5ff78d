"""`pcpc log SUB`: what one does with a log. Each sub-command is a module of its own."""
