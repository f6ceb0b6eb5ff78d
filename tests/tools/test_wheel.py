"""The wheel: one package, with all that its commands read, at work in an empty folder."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from processes import ROOT
from wheel_file import PARTS, wheel_file

pytestmark = pytest.mark.deep

STUDY = """\
from pathlib import Path

from pcpc import plants
from pcpc.plants.study import Case

RIG = Path(plants.__file__).parent / "atb1000" / "rigs" / "hull.yaml"
CHAPTER, TITLE = 0, "A study of one run"


def cases():
    return [Case("all", str(RIG), "pd", "short", ("duration_s=4.0",))]


def report(results):
    return f"runs: {len(results)}"


def draw(results, folder):
    pass
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the installed wheel, and nothing else."""
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel_file(tmp_path_factory.mktemp("source"))) as archive:
        archive.extractall(folder)
    return folder


def pcpc(installed: Path, *words: str, cwd: Path, code: int = 0) -> str:
    """Run a command of the installed package; return what it prints."""
    command = [sys.executable, "-P", "-m", "pcpc.tools.cli", *words]
    environment = os.environ | {"PYTHONPATH": str(installed)}
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == code, f"{words}: {done.returncode}\n{done.stdout}{done.stderr}"
    return done.stdout or done.stderr


def test_nothing_but_the_package_comes_to_the_top(installed: Path) -> None:
    top = {path.name.partition("-")[0] for path in installed.iterdir()}
    assert top == {"pcpc"}, top


def stays(path: Path) -> bool:
    """Return whether a file is in the repository only."""
    return "book" in path.parts or path.parts[:2] == ("tools", "dev")


def test_every_file_that_is_no_test_is_in_it(installed: Path) -> None:
    kinds = {".py", ".yaml", ".dbc", ".md", ".sh", ".c", ".json"}
    own = {
        path.relative_to(ROOT)
        for part in PARTS[:4]
        for path in (ROOT / part).rglob("*")
        if path.suffix in kinds and "__pycache__" not in path.parts
    }
    own -= {path for path in own if stays(path)}
    missing = sorted(str(path) for path in own if not (installed / "pcpc" / path).is_file())
    assert len(own) > 300 and not missing, missing
    assert (installed / "pcpc/py.typed").is_file(), "else a user's mypy takes all for Any"


def test_the_workshop_and_the_book_stay_in_the_repository(installed: Path, tmp_path: Path) -> None:
    parts = (path.relative_to(installed / "pcpc") for path in installed.rglob("pcpc/**/*"))
    assert not [path for path in parts if stays(path)]
    text = pcpc(installed, "help", "all", cwd=tmp_path)
    commands = {line.split()[0] for line in text.splitlines() if line.startswith("  ")}
    assert {"jitter", "experiment"} < commands, text
    assert not {"bench", "evidence", "soak"} & commands, text
    for words in (("jitter", "--help"), ("vm", "--help"), ("doctor",)):
        assert pcpc(installed, *words, cwd=tmp_path)
    for words, code in ((("experiment", "chapter9"), 2), (("bounds", "fuzzy-d03"), 0)):
        told = pcpc(installed, *words, "--quiet", cwd=tmp_path, code=code)
        assert "repository" in told and told.count("\n") == 1, told


def test_an_installation_takes_a_study_of_ones_own(installed: Path, tmp_path: Path) -> None:
    (tmp_path / "study.py").write_text(STUDY)
    pcpc(installed, "experiment", "study.py", "-o", "out", "--quiet", cwd=tmp_path)
    assert "# A study of one run\n\nruns: 1" in (tmp_path / "out" / "results.md").read_text()


def test_nothing_of_an_earlier_build_is_in_it(installed: Path) -> None:
    own = {path.relative_to(installed / "pcpc") for path in (installed / "pcpc").rglob("*.py")}
    extra = sorted(str(path) for path in own if not (ROOT / "pcpc" / path).is_file())
    assert not extra, extra


def test_a_bill_of_materials_is_in_it(installed: Path) -> None:
    (info,) = installed.glob("pcpc-*.dist-info")
    made = json.loads((info / "sboms/pcpc.cdx.json").read_text("utf-8"))
    parts = {one["bom-ref"]: one for one in made["components"]}
    for name, place in (("uplot", "live/host"), ("fzstd", "make/web")):
        content = (installed / f"pcpc/tools/{place}/page/{name}.js").read_bytes()
        assert parts[name]["hashes"][0]["content"] == hashlib.sha256(content).hexdigest()
    lines = (info / "METADATA").read_text("utf-8").splitlines()
    needed = [one.partition(": ")[2] for one in lines if one.startswith("Requires-Dist:")]
    names = {re.split("[^A-Za-z0-9-]", one)[0].lower() for one in needed if "extra ==" not in one}
    required = {ref for ref, one in parts.items() if one.get("scope") == "required"}
    assert required == {f"pypi/{name}" for name in names}
    assert made["metadata"]["component"]["version"] == info.name[5:].removesuffix(".dist-info")


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
