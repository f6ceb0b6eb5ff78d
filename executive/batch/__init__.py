"""Many runs at once: the lanes of one compiled cycle."""
