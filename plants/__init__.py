"""Plant models, one folder each, and the emulator process that runs them."""
