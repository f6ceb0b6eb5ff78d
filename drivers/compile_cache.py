"""Where compiled code is kept: a folder named after a hash of the sources (no numba in here).

numba's own cache checks only the file of the compiled function, so an edit in a file that it calls
would go unnoticed and the old code would run.
"""

import hashlib
import importlib.metadata
import os
import sys
from pathlib import Path

_PROJECT = Path(__file__).resolve().parent.parent
_COMPILED_FOLDERS = ("drivers", "executive", "plants")


def source_hash() -> str:
    """Return 16 hex digits over all sources that can be compiled, numba's and Python's version."""
    digest = hashlib.sha256(importlib.metadata.version("numba").encode())
    digest.update(sys.version.encode())
    for folder in _COMPILED_FOLDERS:
        for path in sorted((_PROJECT / folder).rglob("*.py")):
            digest.update(str(path.relative_to(_PROJECT)).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> Path:
    """Return the folder of compiled code for the present sources (not created here)."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "pcpc" / "compiled" / source_hash()
