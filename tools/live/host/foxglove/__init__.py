"""`pcpc host --foxglove`: a running rig for Foxglove and Lichtblick, and layouts for both."""
