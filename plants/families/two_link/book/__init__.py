"""The book on arms of two links: what the proofs of their laws have in common."""
