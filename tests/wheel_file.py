"""A wheel of the project as it stands, made in a copy in which an earlier build left something."""

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("drivers", "executive", "plants", "tools", "pcpc")


def wheel_file(folder: Path) -> Path:
    """Build the wheel in `folder`, which is empty; return its file."""
    copy = folder / "project"
    copy.mkdir()
    for part in PARTS:
        shutil.copytree(
            ROOT / part, copy / part, symlinks=True, ignore=shutil.ignore_patterns("__pycache__")
        )
    for name in ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    stale = copy / "build/lib/pcpc/tools/stale.py"  # of a build before, deleted since
    stale.parent.mkdir(parents=True)
    stale.write_text("")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    wheel = [*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", str(folder), str(copy)]
    subprocess.run(wheel, check=True, capture_output=True)
    (made,) = folder.glob("*.whl")
    return made
