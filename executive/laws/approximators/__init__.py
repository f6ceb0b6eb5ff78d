"""Two-layer networks as compiled functions on views, with and without jump nodes."""
