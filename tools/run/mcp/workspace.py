"""The folder of a program: digests of its files, and what none of them may be.

Python that a rig loads is read before it runs: a law computes, it opens, asks and changes nothing.
"""

import ast
import functools
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml

from pcpc.executive.own_laws.carried_files import sha256
from pcpc.tools.run.mcp.policy import SHIPPED, Policy, Refused

LOG, RUNS = "log.mcap", "runs"
_MOST_FILES, _MOST_TEXT = 5000, 1 << 18
_NATIVE = (".fmu", ".so", ".pyd", ".dll")
_KEPT = (".yaml", ".yml", ".py", ".dbc", ".csv", ".json", ".toml", ".cfg", ".ini", ".eds")
_IMPORTS = (
    "numpy", "math", "typing", "collections.abc", "pcpc.plants", "pcpc.executive.laws",
)  # fmt: skip
_DENIED = {
    "open", "exec", "eval", "compile", "getattr", "setattr", "delattr", "globals", "locals",
    "vars", "breakpoint", "input", "help", "os", "sys", "io", "subprocess", "importlib", "builtins",
    "ctypes", "ctypeslib", "f2py", "testing", "lib", "load", "save", "savez", "savez_compressed",
    "savetxt", "loadtxt", "genfromtxt", "fromfile", "tofile", "memmap", "dump", "dumps", "modules",
    "write_text", "write_bytes", "read_text", "read_bytes", "unlink", "rename", "replace", "rmdir",
    "mkdir", "touch", "symlink_to", "hardlink_to", "chmod", "iterdir", "glob", "rglob",
    "inspect", "linecache", "types", "get_type_hints", "ForwardRef", "tools",
}  # fmt: skip
_SPECIAL = {"__name__", "__all__", "__doc__", "__file__", "__init__", "__future__"}


def files(workspace: Path) -> Iterator[Path]:
    """Yield all files; Refused for a link out of the workspace, and for too many."""
    count = 0
    for folder, folders, names in os.walk(workspace):
        for name in [*folders, *names]:
            path, count = Path(folder, name), count + 1
            if count > _MOST_FILES:
                raise Refused("disk_MB", f"more than {_MOST_FILES} files in the workspace")
            if path.is_symlink() and not path.resolve().is_relative_to(workspace):
                raise Refused("folders", f"{path} leads out of the workspace")
            if name in names and path.is_file():
                if path.stat().st_nlink > 1:
                    raise Refused("folders", f"{path} has another name elsewhere")
                yield path


def snapshot(workspace: Path) -> dict[str, str]:
    """Return the digests of all files by their names from the workspace; Refused."""
    found = {}
    for path in files(workspace):
        about = path.stat()
        key = about.st_ino, about.st_size, about.st_mtime_ns, about.st_ctime_ns
        found[path.relative_to(workspace).as_posix()] = _digest(path, key)
    return found


@functools.lru_cache(maxsize=2 * _MOST_FILES)
def _digest(path: Path, state: tuple[int, ...]) -> str:
    return sha256(path)


def kept_text(path: Path) -> str | None:
    """Return what the audit keeps of a file; None of one that is large, or no text."""
    if path.suffix not in _KEPT or not path.is_file() or path.stat().st_size > _MOST_TEXT:
        return None
    return path.read_bytes().decode("utf-8", "replace")


def check_size(workspace: Path, rules: Policy, printed: int = 0) -> None:
    """Raise Refused where the workspace, and what a command has printed, are too large."""
    used_MB = (printed + sum(path.stat().st_size for path in files(workspace))) / 1e6
    if used_MB > rules.disk_MB:
        raise Refused("disk_MB", f"{used_MB:.0f} MB are more than {rules.disk_MB:g} MB")


def check(workspace: Path, rules: Policy) -> None:
    """Raise Refused for a file of the workspace that could do more than a law may."""
    check_size(workspace, rules)
    sources, named = [*files(workspace)], set[str]()
    for path in sources:
        if path.suffix in _NATIVE:
            raise Refused("imports", f"{path.name} is native code")
        if path.suffix in (".yaml", ".yml"):
            named |= _checked_names(path, workspace)
    modules = [one for one in sources if one.suffix == ".py" and not _is_test(one, named)]
    for path in modules:
        _check_python(path, (*_IMPORTS, *rules.imports, *(one.stem for one in modules)))


def _is_test(path: Path, named: set[str]) -> bool:
    """Return whether only pytest runs a file: it is called so, and no rig names it."""
    is_named = any(path.name in one for one in named)
    return path.name.startswith(("test_", "conftest")) and not is_named


def _checked_names(path: Path, workspace: Path) -> set[str]:
    """Return a rig's texts; Refused: it names a file from outside, or code not called so."""
    try:
        texts = {*_texts([*yaml.safe_load_all(path.read_bytes())])}
    except yaml.YAMLError:
        raise Refused("folders", f"{path.name} is no YAML") from None
    for text in (part for whole in texts for part in (whole, whole.rpartition(":")[0]) if part):
        place = Path(os.path.realpath(path.parent / text))
        if not any(map(place.is_relative_to, (workspace, SHIPPED))) and os.path.exists(place):
            raise Refused("folders", f"{path.name} names {text!r}, outside the workspace")
        if place.is_file() and place.suffix not in (*_KEPT, ".mcap"):
            raise Refused("imports", f"{path.name} names {text!r}, which is of no known kind")
    return texts


def _texts(whole: Any) -> Iterator[str]:
    """Yield the texts of a document; of what its aliases repeat, once."""
    left, seen = [whole], set[int]()
    while left:
        one = left.pop()
        if isinstance(one, str):
            yield one
        elif isinstance(one, dict | list) and id(one) not in seen:
            seen.add(id(one))
            left += [*one, *one.values()] if isinstance(one, dict) else one


def _check_python(path: Path, allowed: Sequence[str]) -> None:
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):
        return  # it does not run either
    for node in ast.walk(tree):
        modules = [one.name for one in node.names] if isinstance(node, ast.Import) else []
        modules += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        for name in modules:
            if not any(f"{name}.".startswith(f"{one}.") for one in allowed):
                raise Refused("imports", f"{path.name} imports {name}")
        for word in _identifiers(node):
            if word in _DENIED or (word.startswith("__") and word not in _SPECIAL):
                raise Refused("imports", f"{path.name} uses {word}")


def _identifiers(node: ast.AST) -> Iterator[str]:
    if not isinstance(node, ast.Constant):
        for _, value in ast.iter_fields(node):
            for one in value if isinstance(value, list) else [value]:
                yield from one.split(".") if isinstance(one, str) else ()
