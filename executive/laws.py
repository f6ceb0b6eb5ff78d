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
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from drivers.compile_cache import cache_folder
from executive import carried, trial
from executive.carried import PACKAGES, Reads, merge
from executive.errors import did_you_mean
from executive.law_errors import cause, is_numbas, is_users
from executive.prepare import check_ports
from executive.yamlfile import Document, Keys

if TYPE_CHECKING:
    from executive.block import Block

_PROJECT = Path(__file__).resolve().parent.parent
_outside: dict[Path, ModuleType] = {}
_read_by: dict[str, Reads] = {}  # what the import of a module opened, by its name
_PLANTS = (  # the project's folders; another one beside them is a user's
    "actuators", "atb1000", "backlash_map", "backlash_pendulum", "deadzone_arm", "deadzone_map",
    "friction_arm", "payload_arm", "probe", "quarter_car", "telerobot",
)  # fmt: skip
_CONTROLLERS = "executive.controllers"


@dataclass(frozen=True)
class Use:
    """What the trial of a law needs of its rig: settings as given, rate, seed."""

    settings: Mapping[str, float]
    rate_hz: float
    seed: int


def resolve(document: Document, keys: Keys, law: str, use: Use) -> "Block":
    """Return the block that `law` names; any failure of its module is an error of the rig file.

    A law that is not of the project is tried first (`executive.trial`), unless it passed before.
    """
    from executive.block import Block  # here, because it imports numba

    at = (*keys, "law")
    found = re.fullmatch(r"([^:]+)(?::(\w+))?", law)
    if not found:
        raise document.error(at, f"'{law}' is no law; expected NAME, pkg.mod:NAME or file.py:NAME")
    module_name, name = found[1], found[2] or "BLOCK"
    is_file, is_bare = module_name.endswith(".py"), "." not in module_name
    full_name = f"{_CONTROLLERS}.{module_name}" if is_bare else module_name
    file = document.file(at, module_name) if is_file else Path()
    case = users_case(law, file, use)
    if case is not None and (problem := trial.ensure(case)):
        raise document.error(at, problem)
    try:
        with _own_streams():
            module = module_of("" if is_file else full_name, file)
    except (Exception, SystemExit) as error:
        absent = getattr(error, "name", None) if isinstance(error, ModuleNotFoundError) else None
        if absent and f"{full_name}.".startswith(f"{absent}."):
            cure = did_you_mean(module_name, _controllers()) if is_bare else ""
            raise document.error(at, f"no module {full_name}{cure}") from None
        what = "" if is_numbas(error) else f"{module_name} cannot be imported: "
        raise document.error(at, f"{what}{cause(error)}") from error
    block = getattr(module, name, None)
    if isinstance(block, Block):
        try:
            check_ports(block)
        except ValueError as error:
            raise document.error(at, f"{name} of {module_name}: {error}") from error
        return block
    blocks = [key for key, known in vars(module).items() if isinstance(known, Block)]
    kind = type(block).__name__
    what = f"is of type {kind}, not Block" if hasattr(module, name) else "does not exist"
    raise document.error(at, f"{name} of {module_name} {what}{did_you_mean(name, blocks)}")


def users_case(law: str, file: Path, use: Use) -> trial.Case | None:
    """Return what a trial of `law` needs, None for a law of the project; `file` is its module's."""
    module, _, name = law.partition(":")
    if module.endswith(".py"):
        if _is_projects(file):
            return None
        module = ""
    elif "." not in module or module.partition(".")[0] in PACKAGES:
        return None
    else:
        try:
            spec = importlib.util.find_spec(module)
        except (Exception, SystemExit):  # importing it says so
            return None
        if spec is None or spec.origin is None or not is_users(spec.origin):
            return None
        file = Path(spec.origin)
    return trial.Case(str(file), module, name or "BLOCK", use.settings, use.rate_hz, use.seed)


def _is_projects(file: Path) -> bool:
    own = (project_name(file) or "").split(".")
    return own != [""] and (own[0] != "plants" or len(own) == 2 or own[1] in _PLANTS)


def opened() -> Reads:
    """Return what the imports of this process opened, as far as a log is to carry it."""
    found: Reads = {}
    for reads in _read_by.values():
        merge(found, reads)
    return found


def module_of(name: str, file: Path) -> ModuleType:
    """Import the module `name`, or that of `file` where the name is ""."""
    return _import_module(name) if name else _import_file(file)


def compile_step(block: "Block") -> None:
    """Compile a step that its module did not; ValueError says, with the line, why that fails."""
    from drivers.jit import JIT_OFF, STEP, stage

    step: Any = block.step
    if JIT_OFF:
        return
    try:
        if not hasattr(step, "py_func"):
            stage(step)  # what is wrong with it is said first
            raise ValueError("step is plain Python; put @stage above its def")
        if STEP.args not in step.overloads:
            step.compile(STEP)
    except ValueError:
        raise
    except Exception as error:
        raise ValueError(cause(error)) from error


@contextmanager
def _own_streams() -> Iterator[None]:
    """Keep what a module prints out of stdout, and the terminal from a module that reads it."""
    terminal = sys.stdin
    with open(os.devnull, encoding="utf-8") as nothing, redirect_stdout(sys.stderr):
        sys.stdin = nothing
        try:
            yield
        finally:
            sys.stdin = terminal


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
