"""A rig as a page: `pcpc generate web`."""
