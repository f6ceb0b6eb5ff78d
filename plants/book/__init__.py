"""What the studies of several systems are made of; in the repository only, as they are."""
