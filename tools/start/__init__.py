"""What a run starts with: rigs by name, folders, processes, the bus."""

TITLE, PLACE = "before a run: rigs and bus load", 1  # in `pcpc help`
