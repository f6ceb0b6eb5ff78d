"""Evidence: what was injected, what was noticed, what the tests of the safety code are worth."""
