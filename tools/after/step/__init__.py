"""One cycle of a log as a debugger sees it: all variables of a node, recorded or not."""
