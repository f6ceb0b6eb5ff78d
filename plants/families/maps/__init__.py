"""Maps in discrete time: what the systems of chapters 4 and 5 share."""
