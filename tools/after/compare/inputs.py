"""What a rig's run is made of in one version of a repository, so that equal things are not run.

    values       of the rig file over its bases, without controllers that do not run
    files        that it names: DBC, parameters, evaluation, laws; what their Python imports
    pcpc         the modules behind `pcpc simulate`, where the repository holds pcpc itself
    loose files  changed ones that no rig names and no law imports, for rigs with Python of their
                 own: a law may read them

An import means every file whose path ends with its name, so that more counts than is used, never
less. Not seen: files outside the repository, installed packages.
"""

import ast
import hashlib
import json
import os
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.inheritance import inherit_entries
from pcpc.executive.rig.yamlfile import Document, Keys

_RIG = re.compile(r"^rig:\s*['\"]?([\w.-]+)", re.MULTILINE)
_SECTIONS = ("controller", "controllers", "executive", "plant")
_OWN = ("drivers", "executive", "plants", "tools", "pcpc")  # folders of pcpc itself
_ENTRY = "tools/run/simulate.py"
_APART = re.compile(  # of the changed files, what no law reads
    r"(^|/)(\.|test_|conftest\.py|LICENSE|Makefile)|_test\.py$|\.(md|rst|png|svg|pdf|jpg|ipynb|html)$"
)


@dataclass
class Rig:
    """A rig file of a version, read over its bases."""

    name: str
    document: Document

    @property
    def own(self) -> str:
        """The controller that the rig names."""
        return str(self.document.data.get("controller"))

    @property
    def controllers(self) -> list[str]:
        """All controllers that it knows."""
        return list(self.document.data.get("controllers") or ())


@dataclass
class Tree:
    """The files of one version below `root`, which is no link, by their paths from there."""

    root: Path
    files: Sequence[str]
    _imports: dict[str, list[str]] = field(default_factory=dict)
    _hashes: dict[str, str] = field(default_factory=dict)

    @cached_property
    def holds_pcpc(self) -> bool:
        """The repository is that of pcpc."""
        return {"pcpc/__init__.py", _ENTRY} <= self._known_files

    def rig_files(self) -> dict[str, str]:
        """Return the rig files by path, with the rigs' names."""
        names = {}
        for path in self.files:
            if path.endswith((".yaml", ".yml")):
                text = (self.root / path).read_text(encoding="utf-8", errors="replace")
                if name := _RIG.search(text):
                    names[path] = name[1]
        return names

    def rig(self, path: str) -> Rig | None:
        """Return a rig; None for a YAML file of something else. RigError."""
        document = yamlfile.load(self.root / path)
        if not any(isinstance(document.data.get(key), dict) for key in _SECTIONS):
            return None
        inherit_entries(document)
        return Rig(str(document.data.get("rig")), document)

    def digest(self, rig: Rig, controller: str, loose: Sequence[str]) -> str:
        """Return a hash of everything that goes into a run."""
        data = _chosen_values(rig.document.data, controller)
        named = self._named_files(rig.document, data)
        files = self._with_imports(named)
        if any(p.endswith(".py") and not self._is_pcpc(p) for p in files):
            files |= set(loose)
        if self.holds_pcpc:
            files |= self._with_imports({_ENTRY})
        digest = hashlib.sha256(json.dumps(data, sort_keys=True).encode())
        for path in sorted(files):
            digest.update(f"{path} {self._sha256(path)}\n".encode())
        return digest.hexdigest()

    def used(self, rig: Rig) -> set[str]:
        """Return all files that a rig is made of, whichever controller runs."""
        named = self._named_files(rig.document, rig.document.data)
        return self._with_imports(named) | {self._path(file) for file in rig.document.sources}

    def loose(self, changed: Sequence[str], used: Collection[str]) -> list[str]:
        """Return the changed files that no rig is known to use, but that a law may read."""
        return [
            path
            for path in changed
            if path not in used and not self._is_pcpc(path) and not _APART.search(path)
        ]

    def _is_pcpc(self, path: str) -> bool:
        return self.holds_pcpc and path.partition("/")[0] in _OWN

    def _named_files(self, document: Document, data: Any) -> set[str]:
        """Return the files that the texts of a rig name, by path or as a module."""
        files: set[str] = set()
        for keys, text in texts(data, ()):
            name = text.partition(":")[0]
            files.update(self._modules(name))
            file = os.path.normpath(document.place(keys).folder / name)
            if self._path(file) not in self._known_files and os.path.isfile(file):
                file = os.path.realpath(file)  # by way of a linked folder
            files.add(self._path(file))
        return files & self._known_files

    def _path(self, file: str | Path) -> str:
        """Return the path of a file from the root, without looking whether there is one."""
        return str(file).removeprefix(f"{self.root}/")

    @cached_property
    def _known_files(self) -> set[str]:
        return set(self.files)

    @cached_property
    def _by_name(self) -> dict[str, list[str]]:
        """The Python files by the ends of their dotted names: `a.b.c`, `b.c`, `c`."""
        paths: dict[str, list[str]] = {}
        for path in (path for path in self.files if path.endswith(".py")):
            parts = path.removesuffix(".py").removesuffix("/__init__").split("/")
            for number in range(len(parts)):
                paths.setdefault(".".join(parts[number:]), []).append(path)
        return paths

    def _modules(self, name: str) -> list[str]:
        return self._by_name.get(name.removeprefix("pcpc."), [])

    def _with_imports(self, paths: set[str]) -> set[str]:
        """Return files with all that their Python imports, directly and by way of others."""
        reached, todo = set(paths), list(paths)
        while todo:
            path = todo.pop()
            if path not in self._imports:
                self._imports[path] = self._imported_files(path) if path.endswith(".py") else []
            todo += [new for new in self._imports[path] if new not in reached]
            reached.update(self._imports[path])
        return reached

    def _imported_files(self, path: str) -> list[str]:
        try:
            names = _imports((self.root / path).read_bytes())
        except OSError:
            return []
        return sorted({file for name in names for file in self._modules(name)})

    def _sha256(self, path: str) -> str:
        if path not in self._hashes:
            try:
                content = (self.root / path).read_bytes()
                self._hashes[path] = hashlib.sha256(content).hexdigest()
            except OSError:
                self._hashes[path] = "none"
        return self._hashes[path]


@cache
def _imports(source: bytes) -> frozenset[str]:
    """Return the names that Python source imports, and the packages around them."""
    try:
        todo: list[Any] = list(ast.parse(source).body)
    except (SyntaxError, ValueError):
        return frozenset()
    names: list[str] = []
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            module = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [".".join((*module, alias.name)).strip(".") for alias in node.names]
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            node.body = []
        for part in ("body", "orelse", "handlers", "finalbody", "cases"):  # of statements
            inside = getattr(node, part, ())
            todo += inside if isinstance(inside, list) else []
    parts = [name.split(".") for name in names]
    return frozenset(".".join(one[:n]) for one in parts for n in range(1, len(one) + 1))


def _chosen_values(data: dict[str, Any], controller: str) -> dict[str, Any]:
    """Return a rig's values with one controller, and those that may take over from it."""
    overrun = data.get("overrun")
    names = {controller, overrun.get("fallback") if isinstance(overrun, dict) else None}
    standby = data.get("standby")
    names |= {str(name) for name in standby} if isinstance(standby, list) else set()
    chosen = {**data, "controller": controller}
    for key in ("controllers", "expect"):
        if isinstance(data.get(key), dict):
            chosen[key] = {name: one for name, one in data[key].items() if name in names}
    return chosen


def texts(data: Any, above: Keys) -> Iterator[tuple[Keys, str]]:
    """Yield all texts in the values of a rig, each with the keys that lead there."""
    if isinstance(data, dict | list):
        for key, child in data.items() if isinstance(data, dict) else enumerate(data):
            yield from texts(child, (*above, key))
    elif isinstance(data, str):
        yield above, data
