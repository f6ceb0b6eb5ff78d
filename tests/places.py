"""Where the repository lies, and how long a test waits for what has to come."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PATIENCE_S = 240.0  # the first start on a machine compiles, and others may load it
