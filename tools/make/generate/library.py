"""Generated C as a shared library of this machine, in the place of a rig's own steps.

The loop calls a step by an address (`drivers.compiled.stage`); an adapter of four lines gives the C
step the same form. So a whole run in virtual time is computed with C laws, and its log must be the
same.
"""

import ctypes
import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.laws.block import Block
from pcpc.executive.nodes.plan import Plan
from pcpc.tools.make.generate import single
from pcpc.tools.make.generate.translator import elementary
from pcpc.tools.make.generate.translator.law import LETTERS, ROLES, law_files, signature

WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror")
PLAIN = ("-O2",)
Entry = Callable[[Block, str], str]  # from a block and its name to the C of `NAME_entry`


def write(texts: Mapping[str, str], folder: Path) -> list[Path]:
    """Write generated files; return the paths of what is to be compiled."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in texts if name.endswith(".c")]


def compiler() -> str:
    """Return the C compiler of this machine; UserError without one."""
    for name in ("gcc", "cc", "clang"):
        if found := shutil.which(name):
            return found
    raise UserError("no C compiler here; sudo apt install gcc", Exit.ENVIRONMENT)


def run(command: Sequence[str | Path]) -> str:
    """Run a compiler or a program; return what it printed; UserError with its first lines."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode:
        said = " / ".join((done.stderr or done.stdout).strip().splitlines()[:3])
        raise UserError(f"{Path(command[0]).name} ended with {done.returncode}: {said}")
    return done.stdout


def adapter(block: Block, name: str) -> str:
    """Return the C of `NAME_entry`, a step as the loop calls it."""
    has = signature(block)
    given = ", ".join(
        f"({'const ' if role in ('parameters', 'inputs') else ''}{name}_{role} *){LETTERS[role]}"
        for role in ROLES
        if role in has
    )
    unused = " ".join(f"(void){LETTERS[role]};" for role in ROLES if role not in has)
    return (
        f'#include "{name}.h"\n'
        f"int32_t {name}_entry(void *result, void *error, double t, double dt, double *p,\n"
        "        double *x, double *u, double *y);\n"
        f"int32_t {name}_entry(void *result, void *error, double t, double dt, double *p,\n"
        "        double *x, double *u, double *y)\n{\n"
        f"    (void)result; (void)error; {unused}\n"
        f"    {name}_step(t, dt{', ' + given if given else ''});\n    return 0;\n}}\n"
    )


class Library:
    """Blocks in C, compiled and loaded: `entry(name)` for `Plan.external`."""

    def __init__(
        self,
        blocks: Mapping[str, Block],
        folder: Path,
        flags: Sequence[str] = PLAIN,
        in_single: bool = False,
        entry: Entry | None = None,
    ) -> None:
        """`in_single`: compute with floats, rounded on entry; the memory of the loop has doubles.

        `entry`: returns the C of `NAME_entry` in the place of the usual one.
        """
        entry = entry or (single.adapter if in_single else adapter)
        texts: dict[str, str] = {}
        for name, block in blocks.items():
            texts |= law_files(block, name)
        texts = (
            single.single_precision(texts) | single.files()
            if in_single
            else texts | elementary.files()
        )
        for name, block in blocks.items():
            texts[f"{name}_entry.c"] = entry(block, name)
        self.blocks = dict(blocks)
        self._selftest = "pcpc_selftestf" if in_single else "pcpc_selftest"
        sources = write(texts, folder)
        self.path = folder / "laws.so"
        run(
            [
                compiler(),
                *elementary.FLAGS,
                *WARNINGS,
                *flags,
                "-shared",
                "-fPIC",
                "-o",
                self.path,
                *sources,
            ]
        )
        self._library = ctypes.CDLL(str(self.path))

    def entry(self, name: str) -> int:
        """Return the address of a step."""
        found = ctypes.cast(getattr(self._library, f"{name}_entry"), ctypes.c_void_p).value
        assert found is not None
        return found

    def counts(self, symbol: str, size: int) -> list[int]:
        """Return an array of uint64_t of the library."""
        return list((ctypes.c_uint64 * size).in_dll(self._library, symbol))

    def selftest(self) -> int:
        """Return 0 if the library gives the bits of every other machine."""
        return int(getattr(self._library, self._selftest)())


def in_place(folder: Path, flags: Sequence[str] = PLAIN) -> Callable[[Plan], None]:
    """Return what puts C in the place of all steps of a plan: `check` of VirtualRun."""

    def replaced(made: Plan) -> None:
        put(made, folder, flags)

    return replaced


def put(
    made: Plan,
    folder: Path,
    flags: Sequence[str] = PLAIN,
    in_single: bool = False,
    entry: Entry | None = None,
) -> Library:
    """Put C in the place of all steps of a plan; the arguments are those of Library."""
    names = {spec.name: f"{made.role}_{spec.name}" for spec in made.spec.blocks}
    blocks = {names[spec.name]: spec.block for spec in made.spec.blocks}
    library = Library(blocks, folder / made.role, flags, in_single, entry)
    made.external.update({name: library.entry(its) for name, its in names.items()})
    return library
