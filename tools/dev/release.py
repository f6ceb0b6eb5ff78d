"""`make release`: sdist and wheel of a version, in dist/, tried in an empty environment first.

The sdist is made of what git has, the wheel of the sdist. In a new virtual environment without the
repository the wheel then runs a shipped rig and the tutorial's first plant, with its test; and
`pcpc demo` starts from it by pip, uvx and pipx, each in an empty home, with a stopwatch. So it does
with a wheel that is there already: `make release TRY=dist/pcpc-*.whl`.

The wheel brings what this Python compiles of loop, laws and plants, for any processor of this
machine's kind: an environment with the plain wheel compiles it, the second wheel has it. Another
Python, or an edited file, finds nothing there and compiles as ever. Wheels of the same sources from
other kinds of machine give their code to this one:

    ARCH=arm64 .ci/container build/arm64 'make release'
    make release WHEELS=build/arm64/pcpc/dist/*.whl

The wheel also brings a log of the demo's rig, to be seen while another Python compiles; and in
dist/ lies the recipe of conda-forge, for this sdist.
"""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from collections.abc import Sequence
from pathlib import Path
from shutil import copy
from tempfile import TemporaryDirectory
from typing import Any

from pcpc.tools.dev import bill, demo_watch
from pcpc.tools.run.demo import recorded

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = "pcpc/drivers/compiled/shipped"
RECORDED = "pcpc/tools/run/demo"
RECIPE = Path(__file__).with_name("recipe.yaml")
CONDA = {"matplotlib": "matplotlib-base", "msgpack": "msgpack-python"}  # other names there
STARTS = 3
ALL_LAWS = """
import importlib, pkgutil
import pcpc.executive.laws, pcpc.plants
for package in (pcpc.executive.laws, pcpc.plants):
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        importlib.import_module(found.name)
"""
SDIST = "from setuptools import build_meta; import sys; print(build_meta.build_sdist(sys.argv[1]))"


def obstacles(root: Path) -> list[str]:
    """Return what keeps a folder from being released; nothing if it is as git has it.

    What git has exported is no repository, and is released as it is.
    """
    found = []
    if (root / ".git").exists():
        words = ["git", "--no-optional-locks", "status", "--porcelain"]
        done = subprocess.run(words, cwd=root, capture_output=True, text=True, check=True)
        found = [f"not committed: {line[3:]}" for line in done.stdout.splitlines()]
    stale = [root / "build/lib", *root.glob("dist/*")]
    return found + [f"of an earlier build: {one}" for one in stale if one.exists()]


def run(words: Sequence[str | Path], cwd: Path, **environment_too: str) -> str:
    """Run a program; return what it prints. Its failure is shown and ends the release."""
    print("release:", *(str(word).strip().split("\n")[0] for word in words[:6]), flush=True)
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    environment |= environment_too
    done = subprocess.run(
        [str(word) for word in words], cwd=cwd, env=environment, capture_output=True, text=True
    )
    if done.returncode:
        sys.exit(f"{done.stdout}{done.stderr}release: this failed, nothing is in dist/")
    return done.stdout


def built_files(root: Path, folder: Path, others: Sequence[Path] = ()) -> tuple[Path, Path]:
    """Return sdist and wheel of the version that git has, the wheel with compiled code.

    `others`: wheels of the same version with the code of other machines.
    """
    source = root
    if (root / ".git").exists():
        source = folder / "source"
        source.mkdir()
        run(["git", "archive", "-o", folder / "source.tar", "HEAD"], root)
        run(["tar", "xf", folder / "source.tar"], source)
    sdist = folder / run([sys.executable, "-c", SDIST, folder], source).split()[-1]
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation"]
    run([*pip, "-w", folder, sdist], folder)
    (wheel,) = folder.glob("*.whl")
    run(["tar", "xf", sdist], folder)
    (unpacked,) = folder.glob("pcpc-*/")
    own = compiled(wheel, folder, unpacked / SHIPPED)
    for other in others:
        add_code(other, own, unpacked)
    copy(folder / "compiling/recorded/log.mcap", unpacked / RECORDED / recorded.FILE.name)
    wheel.unlink()
    run([*pip, "-w", folder, unpacked], folder)
    return sdist, wheel


def compiled(wheel: Path, folder: Path, target: Path) -> Path:
    """Write what a wheel compiles to MACHINE/HASH in `target`, and return that name."""
    own, cache = environment_of(wheel, folder / "compiling"), folder / "cache"
    held = "require=[{always: time.t_s >= 0}]"  # for the limits these runs are too short
    short = ["--set", "duration_s=0.1", "--set", held]
    first_starts: list[list[str | Path]] = [
        [own / "python", "-c", ALL_LAWS],
        [own / "pcpc", "run", "engage", *short, "--set", "duration_s=0.5", "-o", "run"],
        [own / "pcpc", "run", "engage", *short, "--pacing", "lockstep", "-o", "lockstep"],
        *([own / "pcpc", "simulate", rig, *short, "-o", rig]
          for rig in ("engage", "telerobot-u0")),
        [own / "pcpc", "replay", "run"],
        [own / "pcpc", "simulate", recorded.FILE.stem, *recorded.SETTINGS, "-o", "recorded"],
    ]  # fmt: skip
    for words in first_starts:
        run(words, folder / "compiling", XDG_CACHE_HOME=str(cache))
    (made,) = (cache / "pcpc" / "compiled").iterdir()
    name = Path(os.uname().machine, made.name)
    for file in made.rglob("*.nb[ic]"):
        place = target / name / file.relative_to(made)
        place.parent.mkdir(parents=True, exist_ok=True)
        copy(file, place)
    return name


def add_code(wheel: Path, own: Path, unpacked: Path) -> None:
    """Add the code that another wheel brings; `own`: MACHINE/HASH of this machine's."""
    with zipfile.ZipFile(wheel) as content:
        names = [name for name in content.namelist() if name.startswith(f"{SHIPPED}/")]
        found = {Path(*Path(name).relative_to(SHIPPED).parts[:2]) for name in names}
        if not found:
            sys.exit(f"{wheel}: brings no compiled code; name a wheel of `make release`")
        for machine, digest in (one.parts for one in found):
            if machine == own.parts[0]:
                sys.exit(f"{wheel}: has code for {machine}, as this one; name another machine's")
            if digest != own.parts[1]:
                here = f"{digest}, here {own.parts[1]}"
                sys.exit(f"{wheel}: is of other sources, Python or numba ({here})")
        content.extractall(unpacked, names)


def environment_of(wheel: Path, folder: Path) -> Path:
    """Return the programs of a new environment with a wheel."""
    venv.create(folder, with_pip=True)
    run([folder / "bin/pip", "install", "-q", f"{wheel}[plot]", "pytest"], folder)
    return folder / "bin"


def try_wheel(wheel: Path, folder: Path) -> None:
    """Use a wheel as a stranger does, in an environment of its own."""
    own = environment_of(wheel, folder / "environment")
    nothing = str(folder / "nothing")
    run([own / "pcpc", "run", "engage", "-o", "first"], folder, XDG_CACHE_HOME=nothing)
    if again := list(Path(nothing).rglob("*.nbc")):
        sys.exit(f"release: {len(again)} functions were compiled though the wheel brings them")
    run([own / "pcpc", "simulate", "slew10", "--judge", "-o", "run"], folder)
    run([own / "pcpc", "new", "motor"], folder)
    run([own / "pcpc", "simulate", "motor", "--judge", "-o", "motor-run"], folder)
    run([own / "python", "-m", "pytest", "-q", "motor"], folder)


def try_demo(wheel: Path, folder: Path) -> None:
    """Start the demo as people do, each time in an empty home, and tell when it was seen to move.

    What uvx and pipx download in the first of their starts they have in the others.
    """
    tools = folder / "tools"
    venv.create(tools, with_pip=True)
    run([tools / "bin/pip", "install", "-q", "uv", "pipx"], folder)
    ways: dict[str, list[str | Path]] = {
        "pip": [folder / "environment/bin/pcpc", "demo"],
        "uvx": [tools / "bin/uvx", "--from", wheel, "pcpc", "demo"],
        "pipx": [tools / "bin/pipx", "run", "--spec", wheel, "pcpc", "demo"],
    }
    kept = {"PATH", "LANG", "LC_ALL", "OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"}
    kept |= {name for name in os.environ if name.startswith(("PIP_", "UV_", "SSL_"))}
    for way, words in ways.items():
        caches = folder / f"{way}-cache"  # of downloads; what pcpc keeps lies in the home
        for _ in range(STARTS):
            home = folder / "home"
            home.mkdir()
            environment = {name: os.environ[name] for name in kept & os.environ.keys()}
            environment |= {"HOME": str(home), "UV_CACHE_DIR": str(caches / "uv")}
            environment |= {"PIPX_HOME": str(caches / "pipx")}
            try:
                found = demo_watch.watch([*map(str, words), "--port", "0"], environment, home)
            except RuntimeError as error:
                sys.exit(f"release: {way}: {error}")
            print(f"release: demo by {way}: {found}", flush=True)
            if found.code or "next:" not in found.out:
                sys.exit(f"release: the demo ended with {found.code}: {found.err}")
            if list(home.rglob("*.nbc")):
                sys.exit("release: the demo has compiled what the wheel brings")
            shutil.rmtree(home)


def check_bill(wheel: Path) -> None:
    """Exit unless a wheel has its bill of materials, and that names what compiled its code."""
    with zipfile.ZipFile(wheel) as content:
        (name,) = [one for one in content.namelist() if one.endswith(bill.NAME)] or [""]
        if not name or b'"compiler/numba"' not in content.read(name):
            sys.exit(f"release: {wheel.name} has no bill of materials with its compilers")


def recipe(sdist: Path) -> str:
    """Return the recipe of conda-forge for an sdist, whose requirements are pyproject.toml's."""
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    about, build = project["project"], project["build-system"]["requires"]
    places = {
        "version": about["version"],
        "sha256": hashlib.sha256(sdist.read_bytes()).hexdigest(),
        "python": about["requires-python"].removeprefix(">="),
        "build": _lines(build),
        "run": _lines([*about["dependencies"], *about["optional-dependencies"]["plot"]]),
        "summary": json.dumps(about["description"]),
        "licence": about["license"],
    }
    return re.sub("@([a-z0-9]+)@", lambda found: places[found[1]], RECIPE.read_text("utf-8"))


def _lines(requirements: Sequence[str]) -> str:
    """Return requirements as lines of a recipe, by conda-forge's names: `numpy >=2.2,<3`."""
    found = []
    for one in requirements:
        name, limits = re.split(r"(?=[<>=~])", one.lower(), maxsplit=1)
        found.append(f"- {CONDA.get(name, name)} {limits}")
    return "\n    ".join(found)


def main() -> None:
    """Make and try a release, or try one, or say what is in the way."""
    words = sys.argv[1:]
    tried = words[:1] == ["--try"]
    named = [Path(name).resolve() for name in words[tried:]]
    if lost := [str(one) for one in named if not zipfile.is_zipfile(one)]:
        sys.exit(f"release: no such wheel: {', '.join(lost)}")
    if not tried and (found := obstacles(ROOT)):
        sys.exit("\n".join([*found, "release: commit, or remove this with `make clean`"]))
    with TemporaryDirectory() as place:
        folder = Path(place)
        made = named if tried else built_files(ROOT, folder, named)
        for wheel in named if tried else made[1:]:
            check_bill(wheel)
            try_wheel(wheel, folder)
            try_demo(wheel, folder)
        if tried:
            return
        (ROOT / "dist").mkdir(exist_ok=True)
        for file in made:
            print("release:", copy(file, ROOT / "dist"))
        (ROOT / "dist/recipe.yaml").write_text(recipe(made[0]), "utf-8")


if __name__ == "__main__":
    main()
