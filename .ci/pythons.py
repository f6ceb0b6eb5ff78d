"""Run a command once with every other Python that is here: `python .ci/pythons.py COMMAND...`.

Looked for is python3.X, on the PATH and in the usual places, for each X from the project's oldest
to numba's newest; the one that runs this has been tested. COMMAND finds PYTHON, and VENV for a
virtual environment, in its environment. Versions that are not here are named. The exit code is 1
if COMMAND failed with one of them.
"""

import glob
import os
import subprocess
import sys
import tomllib
from importlib.metadata import metadata
from pathlib import Path

PLACES = (
    *os.get_exec_path(), "/usr/bin", "/usr/local/bin", "/opt/*/bin",
    "~/.pyenv/versions/*/bin", "~/.local/bin", "~/.local/share/uv/python/*/bin",
)  # fmt: skip
_KNOWN = "Programming Language :: Python :: 3."


def versions() -> list[int]:
    """Return the X of each Python 3.X that the project allows and its numba knows."""
    project = tomllib.loads(Path("pyproject.toml").read_text())["project"]
    oldest = int(project["requires-python"].removeprefix(">=3."))
    lines = metadata("numba").get_all("Classifier") or []
    known = [int(line.removeprefix(_KNOWN)) for line in lines if line.startswith(_KNOWN)]
    return [minor for minor in sorted(known) if minor >= oldest]


def found(minor: int, places: tuple[str, ...] = PLACES) -> str | None:
    """Return the first python3.`minor` in `places` that runs and can make an environment."""
    asked = f"import ensurepip, sys, venv; sys.exit(sys.version_info[:2] != (3, {minor}))"
    for place in places:
        for folder in sorted(glob.glob(os.path.expanduser(place))):
            program = os.path.join(folder, f"python3.{minor}")
            if os.access(program, os.X_OK):  # which a shim of pyenv is, whether or not it works
                done = subprocess.run([program, "-c", asked], capture_output=True, check=False)
                if done.returncode == 0:
                    return program
    return None


def main(command: list[str]) -> int:
    """Run `command` with each Python in turn; return the exit code."""
    others = {minor: found(minor) for minor in versions() if minor != sys.version_info[1]}
    missing = ", ".join(f"python3.{minor}" for minor, program in others.items() if program is None)
    if missing:
        print(f"not here, so not tested: {missing}", flush=True)
    failed = []
    for minor, program in others.items():
        if program is not None:
            print(f"python3.{minor}: {program}", flush=True)
            more = {"PYTHON": program, "VENV": f"build/python3.{minor}"}
            if subprocess.run(command, env=os.environ | more, check=False).returncode:
                failed.append(f"python3.{minor}")
    if failed:
        print(f"failed with {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
