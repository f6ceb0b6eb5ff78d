"""`pcpc generate c`: laws and rigs as C99, checked in every build that this machine has."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import did_you_mean, near_file
from pcpc.executive.laws.block import Block
from pcpc.executive.nodes.plan import cycles_of
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.own_laws.modules import module_of
from pcpc.executive.rig import law_lookup
from pcpc.executive.rig.messages import check_no_drive
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.make.generate import builds, cost, precision, single
from pcpc.tools.make.generate.closed import ClosedLoop, digest_of
from pcpc.tools.make.generate.commands import CRequest
from pcpc.tools.make.generate.device import device
from pcpc.tools.make.generate.library import write
from pcpc.tools.make.generate.node import rig_files
from pcpc.tools.make.generate.translator import elementary
from pcpc.tools.make.generate.translator.law import law_files
from pcpc.tools.make.generate.words import identifier
from pcpc.tools.start import rigs
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.progress import Progress
from pcpc.tools.terminal.rooms import part_of

_INTERPRETED = """
import sys
from pcpc.tools.make.generate.cli import python_digest
print(python_digest(sys.argv[1], sys.argv[2] or None, sys.argv[4:], int(sys.argv[3])))
"""


def command(request: CRequest) -> int:
    """Write the C; check it, tell its cost, if asked; return the exit code.

    UserError: wrong input.
    """
    progress = Progress(quiet=request.quiet)
    if is_law(request.what):
        return _of_law(request, progress)
    rig = load_rig(_rig(request.what), request.controller, request.set)
    check_no_drive(rig, "generated C has no drive; generate it of a rig without one")
    if request.device and request.single:
        what = "a device's frames are packed in double; leave out --device or --single"
        raise UserError(what)
    xcp = request.beside.value("xcp")
    if xcp is not None and not request.device:
        raise UserError("--xcp is of a device; give --device too")
    files = device(rig, xcp) if request.device else rig_files(rig, in_single=request.single)
    folder = request.output or Path(f"{identifier(rig.config.rig)}_c")
    if request.output or request.device or not (request.check or request.cost):
        _write_files(files, folder)
    if xcp is not None:
        lacking = part_of("live/xcp", "firmware").absent(files)
        print("\n".join(screen.wrapped_lines(" ".join(lacking), "not in the device: ", "  ")))
    names = [request.controller] if request.controller else list(rig.config.controllers)
    if request.cost:
        given = request.set, request.cycles, request.single, progress
        print("\n".join(cost.cost_table(rig, names, *given)))
    if not request.check:
        return Exit.OK
    code = check(rig, request, progress)
    if request.single:
        print("\n".join(["", *precision.precision_table(rig, names, request.set, progress)]))
    return code


def _of_law(request: CRequest, progress: Progress) -> int:
    """Write a law alone, or tell its cost; return the exit code."""
    if request.check or request.device or request.controller or request.set:
        raise UserError(f"{request.what} is a law; for that name a rig that uses it")
    block, name = block_of(request.what)
    law = law_files(block, name)
    files = (
        single.single_precision(law) | single.files()
        if request.single
        else law | elementary.files()
    )
    if request.output or not request.cost:
        _write_files(files, request.output or Path(f"{name}_c"))
    if request.cost:
        print("\n".join(cost.law_cost_table(block, name, request.cycles, progress)))
    return Exit.OK


def _rig(text: str) -> Path:
    try:
        return Path(rigs.find(text))
    except UserError as error:
        hint = did_you_mean(text, list(law_lookup.shipped_laws()))
        raise UserError(f"{error}; no law either{hint}", error.code) from None


def is_law(text: str) -> bool:
    """Return whether this names a law, not a rig."""
    module = text.partition(":")[0]
    dotted = "." in module and "/" not in module and not module.endswith((".yaml", ".yml"))
    return module.endswith(".py") or module in law_lookup.shipped_laws() or (dotted and ":" in text)


def block_of(text: str) -> tuple[Block, str]:
    """Return the block that a law's name means, and its name in C; UserError."""
    module, _, name = text.partition(":")
    path = Path(module).resolve()
    if module.endswith(".py") and not path.is_file():
        raise UserError(f"{module}: no such file{near_file(Path(module))}")
    try:
        dotted = "" if module.endswith(".py") else law_lookup.shipped_laws().get(module, module)
        found = module_of(dotted, path)
    except ImportError as error:
        raise UserError(f"{module}: {error}") from error
    block = getattr(found, name or "BLOCK", None)
    if not isinstance(block, Block):
        known = [key for key, value in vars(found).items() if isinstance(value, Block)]
        raise UserError(f"{text}: no law {name or 'BLOCK'}{did_you_mean(name or 'BLOCK', known)}")
    stem = Path(found.__file__ or "law").stem
    own = path.parent.name if stem == "model" else stem
    return block, identifier(own if not name or name == "BLOCK" else name)


def _write_files(files: dict[str, str], folder: Path) -> None:
    try:
        write(files, folder)
    except OSError as error:
        what = f"{folder}: cannot be written: {error.strerror}; choose another with -o"
        raise UserError(what, Exit.ENVIRONMENT) from error
    laws = [name for name in files if name.endswith(".c")]
    lines = sum(text.count("\n") for text in files.values())
    print(f"{folder}: {len(files)} files, {lines:,} lines")
    print("\n".join(screen.wrapped_lines(" ".join(sorted(laws)), "  ")))
    print(f"compile with {' '.join(elementary.FLAGS)}")


def python_digest(rig: str, controller: str | None, settings: list[str], cycles: int) -> str:
    """Return the digest of a rig's virtual run."""
    shorter = [
        *settings,
        *_shorter_duration(load_rig(Path(rig), controller, settings, resolve=False), cycles),
    ]
    return _digest(load_rig(Path(rig), controller, shorter), cycles)


def _digest(rig: Rig, cycles: int) -> str:
    return digest_of(in_memory(rig), ClosedLoop(rig).columns(), cycles)


def _shorter_duration(rig: Rig, cycles: int) -> list[str]:
    """Return settings that end a run behind its first cycles."""
    wanted = (cycles + 10) / rig.config.rate_hz
    return [f"duration_s={wanted!r}"] if wanted < rig.config.duration_s else []


def check(rig: Rig, request: CRequest, progress: Progress) -> int:
    """Print the table of builds with their digests; return 1 if one differs, 4 if no C ran.

    UserError: nothing to compare.
    """
    cycles = min(request.cycles, cycles_of(rig))
    closed = ClosedLoop(rig, request.single)
    if not any(closed.columns().values()):
        raise rig.error("", "records no state and no output; there is nothing to be compared")
    words = [str(rig.path), request.controller or "", str(cycles), *request.set]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(closed.files(cycles), folder)
        builds.fixed_files(folder)
        own: list[tuple[str, Callable[[], str]]] = []
        if not request.single:  # Python has no floats: those builds have to agree with each other
            progress.show("Python, compiled by numba")
            expected = _digest(rig, cycles)
            own = [("Python, numba", lambda: expected)]
            own += [("Python, interpreted", lambda: _interpreted_digest(words))]
        python, c = builds.table(folder, own, progress.show)
    progress.close()
    kind = ", laws in float" if request.single else ""
    print(f"{rig.config.rig}, {rig.config.controller}{kind}: {cycles} cycles of the closed loop")
    print("\n".join(screen.table([(f"  {a}", b, c) for a, b, c in (*python, *c)])))
    if any(row.wrong for row in (*python, *c)):
        return Exit.NOT_MET
    if not any(row.compared for row in c):
        least = "two builds" if request.single else "a build"
        what = f"no C was compared: that needs {least} of those that are not here"
        raise UserError(f"{what}; {builds.GCC}", Exit.ENVIRONMENT)
    return Exit.OK


def _interpreted_digest(words: list[str]) -> str:
    """Return the digest of a rig's virtual run without numba, in a process of its own."""
    code = [sys.executable, "-c", _INTERPRETED, *words]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(code, capture_output=True, text=True, env=environment)
    if done.returncode:
        said = done.stderr.strip().splitlines() or [f"ended with {done.returncode}"]
        raise UserError(said[-1])
    return done.stdout.strip()
