"""The command that installs missing packages for the Python that runs.

It names those packages and never this project: an index may have that name from somebody else.
"""

import re
import shlex
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires

_PACKAGES = {"PIL": "pillow", "foxglove": "foxglove-sdk"}  # of modules with other names


def pip_install(*modules: str) -> str:
    """Return `PYTHON -m pip install PACKAGES` for modules, in the versions asked for."""
    names = dict.fromkeys(module.partition(".")[0] for module in modules)
    known = dict(_declared_requirements())
    wanted = [_PACKAGES.get(name, name).lower() for name in names]
    return shlex.join([sys.executable or "python3", "-m", "pip", "install",
                       *(known.get(name, name) for name in wanted)])  # fmt: skip


def _declared_requirements() -> Iterator[tuple[str, str]]:
    """Yield (name, requirement) of all that the project and its extras ask for."""
    try:
        lines = requires("pcpc") or []
    except PackageNotFoundError:  # run from its sources
        return
    for line in lines:
        requirement = line.partition(";")[0].strip()
        if found := re.match(r"[A-Za-z0-9._-]+(?=[^A-Za-z0-9._\[-]|$)", requirement):
            yield found[0].lower(), requirement
