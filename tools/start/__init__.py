"""What a run starts with: rigs by name, folders, processes, the bus."""
