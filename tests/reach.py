"""Which tests a change can reach: `pytest --changed main`, `make test CHANGED=main`.

A test file reaches what it imports, at the top or inside a function, and what that imports; what
the command does that it names ("run"); the plant whose rig or folder it names ("engage"). One that
searches folders (`glob`) reaches all, one of the pages every page. It is an estimate from names:
before a release all tests run.
"""

import ast
import re
import subprocess
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pcpc

ROOT = Path(__file__).resolve().parents[1]
FOR_ALL = ("pyproject.toml", "Makefile", "tests/conftest.py", "tests/reach.py", "tests/copies.py")

_OF_ALL = re.compile(r"^pytestmark = (\[[^]]*\]|.*)", re.MULTILINE)


def marks_of_all(text: str) -> set[str]:
    """Return the marks of all tests of a file; none where one is `quick` all the same."""
    said = _OF_ALL.search(text)
    if said is None or "mark.quick" in text:
        return set()
    return set(re.findall(r"\bmark\.(\w+)", said[1]))


def is_left_out(path: Path, deep: str, marks: str) -> bool:
    """Return whether no test is wanted of a file of deep tests, or of a folder named as a mark."""
    if path.is_dir():
        return f"not {path.name}" in marks
    if deep != "no" or not path.name.startswith("test_"):
        return False
    return "deep" in marks_of_all(path.read_text(encoding="utf-8"))


def changed_files(reference: str) -> set[Path]:
    """Return the files that differ from a version, and those that git does not know yet."""
    words = (["diff", "--name-only", reference, "--"], ["ls-files", "-o", "--exclude-standard"])
    lines = [
        subprocess.run(["git", *some], cwd=ROOT, check=True, capture_output=True, text=True).stdout
        for some in words
    ]
    return {ROOT / name for name in "".join(lines).splitlines()}


def reached(test: Path, changed: set[Path]) -> bool:
    """Return whether a test file may notice a change of these files."""
    if test in changed or any(ROOT / name in changed for name in FOR_ALL):
        return True
    if "glob(" in text(test):
        return bool(changed)
    if test.parent == ROOT / "tests/docs" and any(file.suffix == ".md" for file in changed):
        return True
    files = closure(test)
    folders = {file.relative_to(ROOT).parts[:2] for file in files}
    plants = {folder for folder in folders if folder[0] == "plants" and len(folder) > 1}
    return any(
        file in files
        or (file.suffix != ".py" and file.relative_to(ROOT).parts[:2] in plants)
        or (file.suffix != ".py" and file.parent in {one.parent for one in files})
        for file in changed
    )


@cache
def closure(file: Path) -> frozenset[Path]:
    """Return the files that a file reaches, itself too."""
    found, pending = {file}, [file]
    while pending:
        for other in edges(pending.pop()):
            if other not in found:
                found.add(other)
                pending.append(other)
    return frozenset(found)


@cache
def text(file: Path) -> str:
    return file.read_text(encoding="utf-8")


@cache
def edges(file: Path) -> frozenset[Path]:
    """Return the files that a file names: modules, and in tests commands and plants."""
    if file == ROOT / "pcpc/__init__.py":  # names all that users can import, and imports none
        return frozenset()
    tree = ast.parse(text(file))
    names = [name for node in ast.walk(tree) for name in _imported(node)]
    found = {path for name in names for path in _modules(name)}
    if file.is_relative_to(ROOT / "tests"):
        rooms = [one for one in file.parents if one.is_relative_to(ROOT / "tests")][:-1]
        found |= {one / "conftest.py" for one in rooms if (one / "conftest.py").is_file()}
        words = {
            word
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
            for word in node.value.replace("/", " ").split()
        }
        found |= {path for word in words & commands().keys() for path in commands()[word]}
        found |= {path for word in words & plants().keys() for path in plants()[word]}
    return frozenset(found)


def _imported(node: ast.AST) -> Iterator[str]:
    """Return the modules that a node may import: also what a string names."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module:
        yield node.module
        yield from (f"{node.module}.{alias.name}" for alias in node.names)
    elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        if node.value.id == "pcpc" and node.attr in pcpc._WHERE:
            yield "pcpc." + pcpc._WHERE[node.attr].partition(":")[0]
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        name = node.value.partition(":")[0]  # "tools.api.live:Live"
        if name.startswith(("pcpc.", "executive.", "tools.", "plants.", "drivers.")):
            yield name if name.startswith("pcpc.") else f"pcpc.{name}"


@cache
def _modules(name: str) -> tuple[Path, ...]:
    """Return the files of a module: of the project, or of the tests; none of others."""
    parts = name.split(".")
    if parts[0] == "pcpc":
        places = [ROOT.joinpath(*parts[1:])] if parts[1:] else [ROOT / "pcpc"]
    else:
        places = [file.with_suffix("") for file in files_of_tests().get(parts[0], ())]
    return tuple(
        file
        for place in places
        for file in (place.with_suffix(".py"), place / "__init__.py")
        if file.is_file()
    )


@cache
def files_of_tests() -> dict[str, list[Path]]:
    found: dict[str, list[Path]] = {}
    for file in (ROOT / "tests").rglob("*.py"):
        found.setdefault(file.stem, []).append(file)
    return found


@cache
def commands() -> dict[str, tuple[Path, ...]]:
    """Return the files of each command's module."""
    from pcpc.tools.cli.commands import COMMANDS

    found = {}
    for name, command in COMMANDS.items():
        modules = (f"pcpc.tools.{one.module}" for one in (command, *command.parts))
        found[name] = tuple(path for module in modules for path in _modules(module))
    return found


@cache
def plants() -> dict[str, tuple[Path, ...]]:
    """Return the files of the plant that a rig's or a folder's name stands for, and all laws.

    A rig names laws of the executive by their bare names.
    """
    found: dict[str, tuple[Path, ...]] = {}
    laws = tuple((ROOT / "executive/laws").rglob("*.py"))
    for folder in (ROOT / "plants").iterdir():
        files = (*folder.rglob("*.py"), *laws)
        names: Iterable[str] = [rig.stem for rig in folder.glob("rigs/*.yaml")]
        found |= dict.fromkeys([folder.name, *names, *(f"{name}.yaml" for name in names)], files)
    return found
