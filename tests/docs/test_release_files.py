"""What a release brings beside the code: a lock, a recipe, a bill of materials, safe workflows."""

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from places import ROOT
from rattler_build import RattlerBuildError, Stage0Recipe, VariantConfig

from pcpc.tools.dev import bill, release

TEXT = (ROOT / "pyproject.toml").read_text("utf-8")
PROJECT = tomllib.loads(TEXT)["project"]
WANTED = [
    *PROJECT["dependencies"],
    *(one for extra in PROJECT["optional-dependencies"].values() for one in extra),
]
OWN = "https://files.pythonhosted.org/", "https://pypi.org/simple"


def requirements(lines: list[str]) -> dict[str, Requirement]:
    found = map(Requirement, lines)
    return {canonicalize_name(one.name): one for one in found if one.name != "pcpc"}


def test_the_lock_is_of_these_requirements_and_each_of_its_versions_is_allowed() -> None:
    lock = tomllib.loads((ROOT / "uv.lock").read_text("utf-8"))
    packages: list[dict[str, Any]] = lock["package"]
    (own,) = (one for one in packages if one["name"] == "pcpc")
    known = {
        (canonicalize_name(one["name"]), one.get("specifier", "")): one
        for one in own["metadata"]["requires-dist"]
        if one["name"] != "pcpc"
    }
    asked = {(name, str(r.specifier)) for name, r in requirements(WANTED).items()}
    as_sets = [{(name, frozenset(s.split(","))) for name, s in one} for one in (known, asked)]
    assert as_sets[0] == as_sets[1], as_sets[0] ^ as_sets[1]
    for name, one in requirements(WANTED).items():
        versions = [package["version"] for package in packages if package["name"] == name]
        assert versions and all(v in one.specifier for v in versions), (name, versions)
    files = [file for one in packages for file in (*one.get("wheels", ()), one.get("sdist", {}))]
    urls = [file["url"] for file in files if file]
    urls += [one["source"]["registry"] for one in packages if one["name"] != "pcpc"]
    assert len(urls) > 300 and not [url for url in urls if not url.startswith(OWN)]
    assert all(file["hash"].startswith("sha256:") for file in files if file)


def test_every_requirement_has_a_lowest_version() -> None:
    bare = [name for name, one in requirements(WANTED).items() if not one.specifier]
    assert not bare, f"{bare}: `make test-lowest` would try the oldest that there is"


def test_a_job_tries_the_lowest_versions_and_those_of_the_lock() -> None:
    flow = yaml.safe_load((ROOT / ".github/workflows/tests.yaml").read_text("utf-8"))
    job = flow["jobs"]["versions"]
    targets = job["strategy"]["matrix"]["target"]
    assert [one["run"] for one in job["steps"] if "run" in one] == ["make ${{ matrix.target }}"]
    told = {
        target: subprocess.run(
            ["make", "-n", target], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout
        for target in targets
    }
    assert "--resolution lowest-direct" in told["test-lowest"]
    assert "sync -q --frozen" in told["test-locked"]
    for target in targets:  # make -n also tells what the second make would do
        tests = [line for line in told[target].splitlines() if "--deep no tests/golden" in line]
        assert tests and tests[0].startswith(f"build/{target[5:]}/bin/pytest"), told[target]


@pytest.fixture
def recipe(tmp_path: Path) -> str:
    (tmp_path / "sdist").write_bytes(b"sdist")
    return release.recipe(tmp_path / "sdist")


def test_the_recipe_of_conda_forge_needs_what_the_package_needs(recipe: str) -> None:
    (variant,) = Stage0Recipe.from_yaml(recipe).render(VariantConfig())
    about = variant.recipe
    assert (about.package.name, about.package.version) == ("pcpc", PROJECT["version"])
    here = {value: name for name, value in release.CONDA.items()}
    found = {}
    for line in about.requirements.run:
        name, _, limits = str(line).partition(" ")
        found[here.get(name, name)] = limits
    assert found.pop("python") == PROJECT["requires-python"] and found.pop("__linux") == ""
    wanted = requirements([*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["plot"]])
    as_sets = {name: set(limits.split(",")) for name, limits in found.items()}
    assert as_sets == {name: set(str(r.specifier).split(",")) for name, r in wanted.items()}


@pytest.mark.parametrize(
    ("right", "wrong"),
    [("noarch: python", "noarch: pyton"), ("  number: 0", "  number: x"), ("sha256: ", "sha25: "),
     ("requirements:", "requirments:"), ("numpy >=2.4,<3", "numpy >>2.4")],
)  # fmt: skip
def test_what_reads_the_recipe_refuses_a_wrong_one(recipe: str, right: str, wrong: str) -> None:
    assert right in recipe
    with pytest.raises(RattlerBuildError):
        list(Stage0Recipe.from_yaml(recipe.replace(right, wrong)).render(VariantConfig()))


def test_a_bill_has_vendored_files_packages_and_compilers_and_the_schema_takes_it(
    tmp_path: Path,
) -> None:
    page = tmp_path / "tools/page"
    page.mkdir(parents=True)
    (page / "plot.js").write_text("/* plot 1.2.3 */\ncode")
    (page / "plot-LICENSE.txt").write_text("MIT License")
    (tmp_path / "drivers/compiled/shipped/x86_64/0a").mkdir(parents=True)
    made = bill.bill("1.0.0", tmp_path, ["numpy>=2,<3", "PyYAML~=6.0"], ["numpy>=2", "scipy>=1; x"])
    found = {one["bom-ref"]: one for one in made["components"]}
    assert set(found) == {
        "compiler/llvmlite", "compiler/numba", "plot", "pypi/numpy", "pypi/pyyaml", "pypi/scipy",
    }  # fmt: skip
    assert (found["plot"]["version"], found["pypi/numpy"]["scope"]) == ("1.2.3", "required")
    assert found["pypi/scipy"]["properties"][0]["value"] == ">=1"
    assert found["pypi/scipy"]["scope"] == "optional"
    strict = JsonStrictValidator(SchemaVersion.V1_6)
    assert strict.validate_str(json.dumps(made)) is None
    no_iri = made | {"externalReferences": [{"type": "website", "url": "a b"}]}
    assert strict.validate_str(json.dumps(no_iri)) is not None  # its grammar is made here
    made["components"][0]["type"] = "thing"
    assert strict.validate_str(json.dumps(made)) is not None
    (page / "plot.js").write_text("code")
    with pytest.raises(ValueError, match="version or licence of plot"):
        bill.bill("1.0.0", tmp_path, [], [])


def test_the_workflows_give_no_more_rights_than_they_need() -> None:
    zizmor = shutil.which("zizmor", path=Path(sys.executable).parent)
    assert zizmor, "make tools"
    words = [zizmor, "--offline", "--no-progress", ROOT / ".github"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    for file in sorted((ROOT / ".github/workflows").glob("*.yaml")):
        for used in re.findall(r"uses: (\S+)", file.read_text("utf-8")):
            assert re.fullmatch(r"[\w/.-]+@[0-9a-f]{40}", used), f"{file.name}: {used}"
