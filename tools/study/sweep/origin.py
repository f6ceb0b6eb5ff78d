"""What the rows of a campaign follow from beside its own numbers: a digest of each part, by name.

    rig        the effective rigs, every setting        project    pcpc's own modules
    FILE       the DBC, and what a log would carry: laws, plant, evaluation, what they open
    table T    the numbers of `law: table`, and descriptions of FMUs
    NAME       the version of Python, and of each package that a log names

Processes with equal digests make equal rows of the same draw; where one differs, rows do not mix.
"""

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

from pcpc.executive.errors import RigError
from pcpc.executive.log.provenance import facts
from pcpc.executive.nodes.plan import plan
from pcpc.executive.own_laws import carried_files, modules
from pcpc.executive.rig.buses import virtual_pacing
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.verdict.judge import Judge

_PROJECT = Path(__file__).resolve().parents[3]
_VERSION = "version_"  # of a package, as a log names it


def origin(rigs: Sequence[Rig]) -> dict[str, str]:
    """Return the digests; RigError where a file is no longer what this process has imported."""
    found = {name: text for name, text in facts().items() if name.startswith(_VERSION)}
    found |= {"python": facts()["python"], f"{_VERSION}scipy": version("scipy")}
    found |= {"project": _project(), "rig": _digest(rig.resolved().encode() for rig in rigs)}
    for rig in rigs:
        found[os.path.relpath(rig.dbc, rig.path.parent)] = carried_files.sha256(rig.dbc)
        found |= {f"table {name}": _digest([text.encode()]) for name, text in rig.tables().items()}
        found |= {str(entry["name"]): str(entry["sha256"]) for entry in _files(rig)}
    return found


def difference(one: Mapping[str, str], other: Mapping[str, str]) -> str:
    """Return the names of the parts that differ, in words; "" of equal ones."""
    names = [name for name in {**one, **other} if one.get(name) != other.get(name)]
    return ", ".join(name.replace(_VERSION, "version of ") for name in names)


def _files(rig: Rig) -> list[carried_files.CarriedFile]:
    """Return the files that a log of the rig would carry, but not its drawing."""
    reads = carried_files.Reads()
    if rig.evaluation is not None:
        Judge.of(rig)  # reads what it is made of
        module = modules.outside_module(Path(rig.evaluation.file))
        carried_files.add_reads(reads, modules.reads_of(module) if module else {})
    for role in rig.roles:
        carried_files.add_reads(reads, plan(rig, role, virtual_pacing(rig)).read)
    found = [entry for entry in rig.carried_files(reads) if not entry["draws"]]
    for entry in found:
        if modules.digest_at_import(Path(entry["path"])) not in (None, entry["sha256"]):
            what = "has changed since this process imported it; start a new one"
            raise RigError(f"{entry['path']}: {what}")
    return found


def _project() -> str:
    """Return the digest of the project's own modules, with their places."""
    files = (file for area in carried_files.AREAS for file in (_PROJECT / area).rglob("*.py"))
    about = ((str(file.relative_to(_PROJECT)).encode(), file) for file in files)
    return _digest(part for name, file in sorted(about) for part in (name, file.read_bytes()))


def _digest(parts: Iterable[bytes]) -> str:
    found = hashlib.sha256()
    for part in parts:
        found.update(hashlib.sha256(part).digest())
    return found.hexdigest()
