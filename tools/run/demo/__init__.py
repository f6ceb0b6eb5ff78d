"""`pcpc demo`: a shipped rig in motion, from nothing to the first picture in seconds."""
