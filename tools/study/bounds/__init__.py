"""The theorem of a law, held against a run."""
