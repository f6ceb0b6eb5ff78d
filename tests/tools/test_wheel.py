"""The wheel: one package, with all that its commands read, at work in an empty folder."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from processes import ROOT

PARTS = ("drivers", "executive", "plants", "tools", "pcpc")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the installed wheel, and nothing else."""
    copy = tmp_path_factory.mktemp("source") / "project"
    copy.mkdir()
    for part in PARTS:
        shutil.copytree(
            ROOT / part, copy / part, symlinks=True, ignore=shutil.ignore_patterns("__pycache__")
        )
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    folder = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    wheel = [*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", str(copy), str(copy)]
    subprocess.run(wheel, check=True, capture_output=True)
    (made,) = copy.glob("*.whl")
    with zipfile.ZipFile(made) as archive:
        archive.extractall(folder)
    return folder


def pcpc(installed: Path, *words: str, cwd: Path) -> str:
    """Run a command of the installed package; return what it prints."""
    command = [sys.executable, "-P", "-m", "pcpc.tools.cli", *words]
    environment = os.environ | {"PYTHONPATH": str(installed)}
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{words}: {done.returncode}\n{done.stdout}{done.stderr}"
    return done.stdout


def test_nothing_but_the_package_comes_to_the_top(installed: Path) -> None:
    top = {path.name.partition("-")[0] for path in installed.iterdir()}
    assert top == {"pcpc"}, top


def test_every_file_that_is_no_test_is_in_it(installed: Path) -> None:
    kinds = {".py", ".yaml", ".dbc", ".md", ".sh", ".c", ".json"}
    own = {
        path.relative_to(ROOT)
        for part in PARTS[:4]
        for path in (ROOT / part).rglob("*")
        if path.suffix in kinds and "__pycache__" not in path.parts
    }
    missing = sorted(str(path) for path in own if not (installed / "pcpc" / path).is_file())
    assert len(own) > 300 and not missing, missing


def test_shipped_rigs_are_found_and_a_plant_of_ones_own_is_tried_in_an_empty_folder(
    installed: Path, tmp_path: Path
) -> None:
    assert "hull" in pcpc(installed, "rigs", cwd=tmp_path)
    shutil.copytree(installed / "pcpc" / "plants" / "probe", tmp_path / "own")
    told = pcpc(installed, "check", "own/rig.yaml", "--json", cwd=tmp_path)
    assert str(tmp_path / "own" / "rig.yaml") in told and "law.py:BLOCK" in told, told


def test_a_new_rig_runs_in_an_empty_folder(installed: Path, tmp_path: Path) -> None:
    pcpc(installed, "new", "my-motor", cwd=tmp_path)
    told = json.loads(pcpc(installed, "simulate", "my-motor", "--quiet", "--json", cwd=tmp_path))
    assert told["rig"] == "my-motor" and told["verdict"] == "ok", told
