"""Where the repository lies, for tests that read of it."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
