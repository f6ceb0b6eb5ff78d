"""`make release`: sdist and wheel of a version, in dist/, tried in an empty environment first.

The sdist is made of what git has, the wheel of the sdist. In a new virtual environment without the
repository the wheel then runs a shipped rig and the tutorial's first plant, with its test.
"""

import os
import subprocess
import sys
import venv
from collections.abc import Sequence
from pathlib import Path
from shutil import copy
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[2]
SDIST = "from setuptools import build_meta; import sys; print(build_meta.build_sdist(sys.argv[1]))"


def obstacles(root: Path) -> list[str]:
    """Return what keeps a folder from being released; nothing if it is as git has it."""
    words = ["git", "status", "--porcelain"]
    done = subprocess.run(words, cwd=root, capture_output=True, text=True, check=True)
    found = [f"not committed: {line[3:]}" for line in done.stdout.splitlines()]
    stale = [root / "build/lib", *root.glob("dist/*")]
    return found + [f"of an earlier build: {one}" for one in stale if one.exists()]


def run(words: Sequence[str | Path], cwd: Path) -> str:
    """Run a program; return what it prints. Its failure is shown and ends the release."""
    print("release:", *(str(word) for word in words[:6]), flush=True)
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        [str(word) for word in words], cwd=cwd, env=environment, capture_output=True, text=True
    )
    if done.returncode:
        sys.exit(f"{done.stdout}{done.stderr}release: this failed, nothing is in dist/")
    return done.stdout


def built(root: Path, folder: Path) -> tuple[Path, Path]:
    """Return sdist and wheel of the version that git has."""
    source = folder / "source"
    source.mkdir()
    run(["git", "archive", "-o", folder / "source.tar", "HEAD"], root)
    run(["tar", "xf", folder / "source.tar"], source)
    sdist = folder / run([sys.executable, "-c", SDIST, folder], source).split()[-1]
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation"]
    run([*pip, "-w", folder, sdist], folder)
    (wheel,) = folder.glob("*.whl")
    return sdist, wheel


def tried(wheel: Path, folder: Path) -> None:
    """Use a wheel as a stranger does, in an environment of its own."""
    venv.create(folder / "environment", with_pip=True)
    own = folder / "environment" / "bin"
    run([own / "pip", "install", "-q", f"{wheel}[plot]", "pytest"], folder)
    run([own / "pcpc", "simulate", "slew10", "--judge", "-o", "run"], folder)
    run([own / "pcpc", "new", "motor"], folder)
    run([own / "pcpc", "simulate", "motor", "--judge", "-o", "first"], folder)
    run([own / "python", "-m", "pytest", "-q", "motor"], folder)


def main() -> None:
    """Make and try a release, or say what is in the way."""
    if found := obstacles(ROOT):
        sys.exit("\n".join([*found, "release: commit, or remove this with `make clean`"]))
    with TemporaryDirectory() as place:
        folder = Path(place)
        made = built(ROOT, folder)
        tried(made[1], folder)
        (ROOT / "dist").mkdir(exist_ok=True)
        for file in made:
            print("release:", copy(file, ROOT / "dist"))


if __name__ == "__main__":
    main()
