"""Which commit changed the bits of a run first, and where in the run it did so."""
