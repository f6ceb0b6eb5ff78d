"""The workshop of the project itself, not installed for users: evidence, bench."""
