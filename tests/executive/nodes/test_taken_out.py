"""A feature of a node is a few files and a line elsewhere: without them all others work as before.

The statements that name it go, in a copy of the executive; the rows by which logs number counters,
faults and events stay, as in a version that no longer has it.
"""

import ast
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from places import ROOT

pytestmark = pytest.mark.deep
NUMBERED = {"control.py", "faults.py", "events.py"}
FILES: Mapping[str, tuple[str, ...]] = {
    "intrusion": (
        "loop/intrusion.py", "loop/intrusion_layout.py", "nodes/planned_intrusion.py",
    ),
    "plausib": (
        "loop/plausibility.py", "loop/plausibility_layout.py", "nodes/planned_plausible.py",
    ),
}  # fmt: skip
NAMED_IN = {
    "intrusion": {"doubts.py", "layout.py", "parts.py", "schema.py"},
    "plausib": {"doubts.py", "layout.py", "parts.py", "schema.py", "node_keys.py"},
}
SCRIPT = """
import hashlib, sys
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
log = in_memory(load_rig(sys.argv[1], settings=["duration_s=0.01", *sys.argv[2:]]))
for name, node in log.node.items():
    for columns in (node.columns, node.timing):
        print(name, {key: hashlib.sha1(bytes(columns[key])).hexdigest() for key in columns})
"""


class Without(ast.NodeTransformer):
    """Takes out each statement, name of an import and entry of a tuple that names a feature."""

    def __init__(self, feature: str) -> None:
        self.feature = feature

    def names_it(self, node: ast.AST) -> bool:
        """Return whether the code of a node names the feature."""
        return re.search(self.feature, ast.unparse(node), re.IGNORECASE) is not None

    def generic_visit(self, node: ast.AST) -> Any:
        """Leave out the smallest that names it; a text alone is a docstring."""
        if isinstance(node, ast.ImportFrom):
            inner = re.search(self.feature, node.module or "") is None
            node.names = [one for one in node.names if inner and not self.names_it(one)]
            return node if node.names else None
        if isinstance(node, ast.ClassDef) and re.search(self.feature, node.name, re.IGNORECASE):
            return None
        if isinstance(node, ast.If) and self.names_it(node.test):
            return None
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return node
        if isinstance(node, ast.Tuple):
            node.elts = [one for one in node.elts if not self.names_it(one)]
        super().generic_visit(node)
        if isinstance(node, ast.If) and not node.body:
            return None
        is_simple = isinstance(node, ast.stmt) and not hasattr(node, "body")
        return None if is_simple and self.names_it(node) else node


def take_out(feature: str, copy: Path) -> set[str]:
    """Take a feature out of a copy of the package; return where it was named besides its files."""
    for name in FILES[feature]:
        (copy / "executive" / name).unlink()
    named = set()
    for file in (copy / "executive").rglob("*.py"):
        text = file.read_text("utf-8")
        if file.name in NUMBERED or not re.search(feature, text, re.IGNORECASE):
            continue
        tree = ast.parse(text)
        before, left = ast.unparse(tree), ast.unparse(Without(feature).visit(tree))
        if left != before:
            file.write_text(left)
            named.add(file.name)
    return named


def run(copy: Path, *settings: str) -> subprocess.CompletedProcess[str]:
    """Run a rig in a copy, interpreted."""
    environment = {**os.environ, "PYTHONPATH": str(copy), "NUMBA_DISABLE_JIT": "1"}
    rig = ROOT / "plants/probe/rig.yaml"
    words = [sys.executable, "-c", SCRIPT, str(rig), *settings]
    return subprocess.run(words, cwd=copy, env=environment, capture_output=True, text=True)


@pytest.fixture(scope="module")
def whole() -> str:
    """Return what a run of the whole package gives."""
    return run(ROOT).stdout


@pytest.mark.parametrize("features", [["intrusion"], ["plausib"], ["intrusion", "plausib"]])
def test_without_the_files_of_a_feature_and_its_lines_all_else_works(
    features: list[str], whole: str, tmp_path: Path
) -> None:
    for part in ("drivers", "executive", "plants", "pcpc", "pyproject.toml"):
        if (ROOT / part).is_file():
            shutil.copy(ROOT / part, tmp_path)
        else:
            leave = shutil.ignore_patterns("__pycache__", "book", "runs")
            shutil.copytree(ROOT / part, tmp_path / part, symlinks=True, ignore=leave)
    for feature in features:
        assert take_out(feature, tmp_path) == NAMED_IN[feature]
    done = run(tmp_path)
    assert done.stdout == whole != "", done.stderr[-2000:]
    gone = {"intrusion": "supervisor.intrusion=hold", "plausib": "errors.implausible=1"}
    for feature, setting in gone.items():
        refused = run(tmp_path, setting)
        assert ("no such setting" in refused.stderr) == (feature in features), refused.stderr[-500:]
