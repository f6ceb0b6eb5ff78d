"""From the text of a law to its block: `pd`, `pkg.mod:NAME` or `model.py:NAME`.

numba is imported with the first law.
"""

import hashlib
import importlib
import importlib.util
import json
import os
import pkgutil
import re
import sys
import traceback
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from drivers.compile_cache import cache_folder
from executive import carried, yamlfile
from executive.carried import PACKAGES, Reads
from executive.errors import did_you_mean
from executive.yamlfile import Document, Keys

if TYPE_CHECKING:
    from executive.block import Block

_PROJECT = Path(__file__).resolve().parent.parent
_outside: dict[Path, ModuleType] = {}
_read_by: dict[str, Reads] = {}  # what the import of a module opened, by its name
_CONTROLLERS = "executive.controllers"


def resolve(document: Document, keys: Keys, law: str) -> "Block":
    """Return the block that `law` names; any failure of its module is an error of the rig file."""
    from executive.block import Block  # here, because it imports numba

    at = (*keys, "law")
    found = re.fullmatch(r"([^:]+)(?::(\w+))?", law)
    if not found:
        raise document.error(at, f"'{law}' is no law; expected NAME, pkg.mod:NAME or file.py:NAME")
    module_name, name = found[1], found[2] or "BLOCK"
    is_file, is_bare = module_name.endswith(".py"), "." not in module_name
    full_name = f"{_CONTROLLERS}.{module_name}" if is_bare else module_name
    file = document.file(at, module_name) if is_file else Path()
    try:
        module = _import_file(file) if is_file else _import_module(full_name)
    except Exception as error:
        absent = getattr(error, "name", None) if isinstance(error, ModuleNotFoundError) else None
        if absent and f"{full_name}.".startswith(f"{absent}."):
            cure = did_you_mean(module_name, _controllers()) if is_bare else ""
            raise document.error(at, f"no module {full_name}{cure}") from None
        raise document.error(at, f"{module_name} cannot be imported: {_cause(error)}") from error
    block = getattr(module, name, None)
    if isinstance(block, Block):
        return block
    blocks = [key for key, known in vars(module).items() if isinstance(known, Block)]
    kind = type(block).__name__
    what = f"is of type {kind}, not Block" if hasattr(module, name) else "does not exist"
    raise document.error(at, f"{name} of {module_name} {what}{did_you_mean(name, blocks)}")


def _cause(error: Exception) -> str:
    """Return `file:line: error`, in one line, of what went wrong in a module."""
    text, name = " ".join(str(error).split()), type(error).__name__
    if isinstance(error, SyntaxError) and error.filename:
        return f"{yamlfile.shown(Path(error.filename))}:{error.lineno}: {name}: {error.msg}"
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{yamlfile.shown(Path(last.filename))}:{last.lineno}: {name}: {text}"


def _controllers() -> list[str]:
    package = importlib.import_module(_CONTROLLERS)
    return [module.name for module in pkgutil.iter_modules(package.__path__)]


def _import_file(file: Path) -> ModuleType:
    """Import a Python file, once per process.

    A file of the project gets its dotted name, any other one a name made of its path: the compile
    cache stores the module's name, so that it must be the same in every process.
    """
    if (own_name := project_name(file)) is not None:
        return importlib.import_module(own_name)
    if file in _outside:
        return _outside[file]
    known = _Remembered(file)
    with carried.noted() as reads:
        module = _execute(file, known.module_name())
    reads.pop(file, None)
    if known.is_news(reads):
        module = _execute(file, known.module_name())
    _outside[file], _read_by[module.__name__] = module, reads
    return module


def _import_module(name: str) -> ModuleType:
    """Import an installed module; note what a module from outside the project opens."""
    if name in sys.modules or name.partition(".")[0] in PACKAGES:
        return importlib.import_module(name)
    with carried.noted() as reads:
        module = importlib.import_module(name)
    _read_by[name] = reads
    return module


def source(document: Document, keys: Keys, law: str) -> tuple[Path | None, Reads]:
    """Return the file of an imported law, and what its import opened; None for the project's."""
    name = law.partition(":")[0]
    if name.endswith(".py"):
        module = _outside.get(document.file(keys, name))
    else:
        module = sys.modules.get(name) if "." in name else None
    file = getattr(module, "__file__", None)
    if module is None or file is None or module.__name__.partition(".")[0] in PACKAGES:
        return None, {}
    return Path(file).resolve(), _read_by.get(module.__name__, {})


class _Remembered:
    """What the import of a law opened the last time, kept beside the compiled code.

    Tables and modules that a law reads end up in its compiled code, so that their content is in the
    name under which that is cached.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self._path = hashlib.sha256(str(file).encode()).hexdigest()
        self._note = cache_folder() / "reads" / f"{self._path}.json"
        self._files: list[str] = []
        with suppress(OSError, ValueError):
            noted = json.loads(self._note.read_text(encoding="utf-8"))
            self._files = [str(name) for name in noted if isinstance(noted, list)]

    def module_name(self) -> str:
        """Return a name made of the law's path and of what it read."""
        digest = hashlib.sha256(self._path.encode())
        for name in self._files:
            with suppress(OSError):
                digest.update(name.encode() + carried.sha256(Path(name)).encode())
        mark = digest.hexdigest() if self._files else self._path
        return f"{self.file.stem}_{mark[:16]}"

    def is_news(self, reads: Reads) -> bool:
        """Remember what was read; return whether it is other than the last time."""
        files = sorted(map(str, reads))
        if files == self._files:
            return False
        self._files = files
        with suppress(OSError):
            self._note.parent.mkdir(parents=True, exist_ok=True)
            new = self._note.with_suffix(f".{os.getpid()}")
            new.write_text(json.dumps(files), encoding="utf-8")
            new.replace(self._note)
        return True


def _execute(file: Path, name: str) -> ModuleType:
    """Run a file as module `name`; modules beside it can be imported by their names."""
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))  # last: it hides nothing
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None and spec.loader is not None, "a .py file has a loader"
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def project_name(file: Path) -> str | None:
    """Return the dotted name of a module of this project, given its file; None for another file."""
    if not file.is_relative_to(_PROJECT):
        return None
    parts = file.relative_to(_PROJECT).with_suffix("").parts
    if parts[0] not in PACKAGES or not all(part.isidentifier() for part in parts):
        return None  # a file beside the packages has a dotted name in some processes only
    try:
        spec = importlib.util.find_spec(".".join(parts))
    except ModuleNotFoundError:
        return None
    return spec.name if spec is not None and spec.origin == str(file) else None
