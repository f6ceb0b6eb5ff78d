"""`pcpc fit`: parameters of a plant from a log, with their uncertainty."""
