"""The folder of a program: digests of its files, and what none of them may be.

Python that a rig loads is read before it runs: a law computes, it opens, asks and changes nothing.
"""

import ast
import functools
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import yaml

from pcpc.executive.own_laws.carried_files import sha256
from pcpc.tools.run.mcp.policy import SHIPPED, Policy, Refused

LOG, RUNS = "log.mcap", "runs"
KEPT = (".yaml", ".yml", ".py", ".dbc", ".csv", ".json", ".toml", ".cfg", ".ini", ".eds")
_MOST_FILES = 5000
_NATIVE = (".fmu", ".so", ".pyd", ".dll", ".pyc", "entry_points.txt")
_IMPORTS = (
    "numpy", "math", "typing", "collections.abc", "pcpc.plants", "pcpc.executive.laws",
)  # fmt: skip
_DENIED = {
    "open", "exec", "eval", "compile", "getattr", "setattr", "delattr", "globals", "locals",
    "vars", "breakpoint", "input", "help", "os", "sys", "io", "subprocess", "importlib", "builtins",
    "ctypes", "ctypeslib", "f2py", "testing", "test", "distutils", "lib", "load", "loads", "save",
    "savez", "savez_compressed", "savetxt", "loadtxt", "genfromtxt", "fromregex", "fromfile",
    "tofile", "memmap", "dump", "dumps", "modules", "write_text", "write_bytes", "read_text",
    "read_bytes", "unlink", "rename", "replace", "rmdir", "mkdir", "touch", "symlink_to",
    "hardlink_to", "chmod", "iterdir", "glob", "rglob", "Path", "inspect", "linecache", "types",
    "get_type_hints", "ForwardRef", "tools", "yaml", "can", "cantools", "pickle", "operator",
    "attrgetter", "methodcaller", "string", "Formatter", "DataSource", "module_of", "pip_install",
    "gi_frame", "cr_frame", "ag_frame", "tb_frame", "f_back", "f_globals", "f_locals", "f_builtins",
    "_core", "_utils", "_pickle", "_pytesttester", "functools", "py_func",
}  # fmt: skip
_SPECIAL = {"__name__", "__all__", "__doc__", "__file__", "__init__", "__future__"}


def files(workspace: Path) -> Iterator[Path]:
    """Yield all files; Refused for what is no file, leads out of the workspace, or is too much."""
    count = 0
    for folder, folders, names in os.walk(workspace):
        for path in (Path(folder, name) for name in [*folders, *names]):
            count += 1
            if count > _MOST_FILES:
                raise Refused("disk_MB", f"more than {_MOST_FILES} files in the workspace")
            if not path.resolve().is_relative_to(workspace):
                raise Refused("folders", f"{path} leads out of the workspace")
            if path.is_file():
                if path.stat().st_nlink > 1:
                    raise Refused("folders", f"{path} has another name elsewhere")
                yield path
            elif not path.is_dir():
                raise Refused("folders", f"{path} is neither a file nor a folder")


def snapshot(workspace: Path) -> dict[str, str]:
    """Return the digests of all files by their names from the workspace; Refused."""
    return {path.relative_to(workspace).as_posix(): _digest(path, _state(path))
            for path in files(workspace)}  # fmt: skip


def touched(workspace: Path, names: Iterable[str], since_ns: int) -> list[str]:
    """Return which files, and folders around those that are no runs', were changed since then."""
    files = [Path(name) for name in names]
    around = {above for file in files if file.parts[0] != RUNS for above in file.parents}
    there = [one for one in (*files, *around) if os.path.lexists(workspace / one)]
    return [str(one) for one in there if (workspace / one).lstat().st_ctime_ns > since_ns]


def _state(path: Path) -> tuple[int, ...]:
    about = path.stat()
    return about.st_ino, about.st_size, about.st_mtime_ns, about.st_ctime_ns


@functools.lru_cache(maxsize=2 * _MOST_FILES)
def _digest(path: Path, state: tuple[int, ...]) -> str:
    return sha256(path)


def check_size(workspace: Path, rules: Policy, printed: int = 0) -> None:
    """Raise Refused where the workspace, and what a command has printed, are too large."""
    used = printed + sum(path.stat().st_size for path in files(workspace))
    rules.limit("disk_MB", used / 1e6)


def check(workspace: Path, rules: Policy) -> None:
    """Raise Refused for a file of the workspace that could do more than a law may."""
    check_size(workspace, rules)
    sources, named = [*files(workspace)], set[str]()
    for path in sources:
        if path.name.endswith(_NATIVE):
            raise Refused("imports", f"{path.name} is code that nobody reads")
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
        tokens = [*yaml.scan(path.read_bytes())]
    except (yaml.YAMLError, UnicodeError):
        raise Refused("folders", f"{path.name} is no YAML") from None
    texts = {str(one.value) for one in tokens if isinstance(one, yaml.ScalarToken)}
    for text in (part for whole in texts for part in (whole, whole.rpartition(":")[0]) if part):
        place = Path(os.path.realpath(path.parent / text))
        is_path = text.startswith("/") or "../" in text or os.path.exists(place)
        if is_path and not any(map(place.is_relative_to, (workspace, SHIPPED))):
            raise Refused("folders", f"{path.name} names {text!r}, outside the workspace")
        if place.is_file() and place.suffix not in (*KEPT, ".mcap"):
            raise Refused("imports", f"{path.name} names {text!r}, which is of no known kind")
    return texts


def _check_python(path: Path, allowed: Sequence[str]) -> None:
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):
        return  # it does not run either
    imports = [one for one in ast.walk(tree) if isinstance(one, ast.Import | ast.ImportFrom)]
    others = {(one.asname or one.name).partition(".")[0] for node in imports for one in node.names}
    for node in ast.walk(tree):
        if _owner_name(node) in others:
            raise Refused("imports", f"{path.name} changes {ast.unparse(node)}")
        modules = [one.name for one in node.names] if isinstance(node, ast.Import) else []
        modules += [node.module or "."] if isinstance(node, ast.ImportFrom) else []
        for name in modules:
            if not any(f"{name}.".startswith(f"{one}.") for one in allowed):
                raise Refused("imports", f"{path.name} imports {name}")
        for word in () if isinstance(node, ast.Constant) else _words(node):
            if word in _DENIED or (word.startswith("__") and word not in _SPECIAL):
                raise Refused("imports", f"{path.name} uses {word}")


def _owner_name(node: ast.AST) -> str:
    """Return the name of the object that a node sets or deletes something of; "" for none."""
    if isinstance(getattr(node, "ctx", None), ast.Load) or isinstance(node, ast.Name):
        return ""
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


def _words(node: ast.AST) -> Iterator[str]:
    for _, value in ast.iter_fields(node):
        for one in value if isinstance(value, list) else [value]:
            yield from one.split(".") if isinstance(one, str) else ()
