"""`pcpc sweep`: thousands of runs of a rig with varied values, and what follows from them."""
