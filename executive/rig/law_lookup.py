"""From the text of a law to its block: `pd`, `references:step`, `pkg.mod:NAME` or `model.py:NAME`.

numba is imported with the first law.
"""

import importlib
import importlib.util
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from pcpc.executive.errors import did_you_mean
from pcpc.executive.own_laws import trial
from pcpc.executive.own_laws.carried_files import Reads
from pcpc.executive.own_laws.law_errors import cause, is_numba_error, is_users
from pcpc.executive.own_laws.modules import (
    OURS,
    PROJECT,
    module_of,
    outside_module,
    own_streams,
    project_name,
    reads_of,
)
from pcpc.executive.own_laws.preparation import check_size
from pcpc.executive.rig.yamlfile import Document, Keys

if TYPE_CHECKING:
    from pcpc.executive.laws.block import Block

_READY = tuple(f"executive/laws/{name}.py" for name in ("references", "profiles", "sequences"))
_LAWS = "plants/*/laws/*.py", "plants/families/*/laws/*.py"  # of systems, of families of them


@dataclass(frozen=True)
class Use:
    """What the trial of a law needs of its rig: settings as given, rate, seed."""

    settings: Mapping[str, float]
    rate_hz: float
    seed: int


def law_block(document: Document, keys: Keys, law: str, use: Use) -> "Block":
    """Return the block that `law` names; any failure of its module is an error of the rig file.

    A law that is not of the project is tried first (`executive.own_laws.trial`), unless it passed
    before.
    """
    from pcpc.executive.laws.block import Block  # here, because it imports numba

    its_keys = (*keys, "law")
    parts = re.fullmatch(r"([^:]+)(?::(\w+))?", present_name(law))
    if not parts:
        raise document.error(
            its_keys, f"'{law}' is not a law; expected NAME, pkg.mod:NAME or file.py:NAME"
        )
    module_name, name = parts[1], parts[2] or "BLOCK"
    is_file, is_bare = module_name.endswith(".py"), "." not in module_name
    full_name = shipped_laws().get(module_name, module_name) if is_bare else module_name
    file = document.file(its_keys, module_name) if is_file else Path()
    case = users_case(law, file, use)
    if case is not None and (problem := trial.law_problem(case)):
        raise document.error(its_keys, problem)
    try:
        with own_streams():
            module = module_of("" if is_file else full_name, file)
    except (Exception, SystemExit) as error:
        absent = getattr(error, "name", None) if isinstance(error, ModuleNotFoundError) else None
        if absent and f"{full_name}.".startswith(f"{absent}."):
            cure = did_you_mean(module_name, shipped_laws()) if is_bare else ""
            phrase = "law" if is_bare else "module"
            raise document.error(its_keys, f"no {phrase} {full_name}{cure}") from None
        phrase = "" if is_numba_error(error) else f"{module_name} cannot be imported: "
        raise document.error(its_keys, f"{phrase}{cause(error)}") from error
    block = getattr(module, name, None)
    if isinstance(block, Block):
        try:
            check_size(block)
        except ValueError as error:
            raise document.error(its_keys, f"{name} of {module_name}: {error}") from error
        return block
    blocks = [key for key, known in vars(module).items() if isinstance(known, Block)]
    kind = type(block).__name__
    phrase = f"is of type {kind}, not Block" if hasattr(module, name) else "does not exist"
    cure = did_you_mean(name, blocks) if blocks else f"; end the file with {name} = Block(step)"
    raise document.error(its_keys, f"{name} of {module_name} {phrase}{cure}")


def users_case(law: str, file: Path, use: Use) -> trial.TrialCase | None:
    """Return what a trial of `law` needs, None for a law of the project; `file` is its module's."""
    module, _, name = present_name(law).partition(":")
    if module.endswith(".py"):
        if _is_projects(file):
            return None
        module = ""
    elif "." not in module or module.startswith(OURS):
        return None
    else:
        try:
            spec = importlib.util.find_spec(module)
        except (Exception, SystemExit):  # importing it says so
            return None
        if spec is None or spec.origin is None or not is_users(spec.origin):
            return None
        file = Path(spec.origin)
    return trial.TrialCase(str(file), module, name or "BLOCK", use.settings, use.rate_hz, use.seed)


def _is_projects(file: Path) -> bool:
    own = (project_name(file) or "").split(".")[1:]
    return own != [] and (own[0] != "plants" or len(own) == 2 or own[1] in shipped_plants())


def present_name(law: str) -> str:
    """Return the present name of a law of the project that a log calls by an earlier one."""
    module, colon, name = law.partition(":")
    parts = module.split(".")
    if [*parts, ""][OURS[:-1] == parts[0]] == "executive" and parts[-1] in shipped_laws():
        return parts[-1] + colon + name
    ours = parts[0] == "plants" and not shipped_plants().isdisjoint(parts[1:2])
    return OURS + law if ours else law


@cache
def shipped_plants() -> frozenset[str]:
    """Return the packages of `plants`; a folder there without `__init__.py` is a user's."""
    return frozenset(file.parent.name for file in PROJECT.glob("plants/*/__init__.py"))


@cache
def shipped_laws() -> dict[str, str]:
    """Return the dotted names of the modules of laws that a rig may name bare."""
    files = [file for pattern in (*_LAWS, *_READY) for file in PROJECT.glob(pattern)]
    names = {file.stem: file.relative_to(PROJECT).with_suffix("").parts for file in files}
    return {stem: OURS + ".".join(parts) for stem, parts in names.items() if stem != "__init__"}


def law_source(document: Document, keys: Keys, law: str) -> tuple[Path | None, Reads]:
    """Return the file of an imported law, and what its import opened; None for the project's."""
    name = law.partition(":")[0]
    if name.endswith(".py"):
        module = outside_module(document.file(keys, name))
    else:
        module = sys.modules.get(name) if "." in name else None
    file = getattr(module, "__file__", None)
    if module is None or file is None or module.__name__.startswith(OURS):
        return None, {}
    return Path(file).resolve(), reads_of(module)
