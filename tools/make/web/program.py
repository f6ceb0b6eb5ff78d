"""The closed loop of a rig as a WebAssembly module without imports.

    start()         all nodes have their first values. 0, or a self-test refuses
    run(n)          the next n cycles of the executive, at most BATCH, and what follows below; the
                    first call begins with cycle 0 of the lower nodes
    count(node)     how many rows the last call left of a node, from the executive down
    rows(node)      where they lie: a double a column
    place(node, i)  where the i-th value that can be set lies: parameters, then states

The cycles are those of `tools.make.generate.closed`.
"""

import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.nodes.plan import cycles_of
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.make.generate.builds import fixed_files
from pcpc.tools.make.generate.closed import ClosedLoop
from pcpc.tools.make.generate.library import WARNINGS, run, write
from pcpc.tools.make.generate.translator.elementary import FLAGS

BATCH = 256
CURE = "no compiler for wasm32 here; pip install ziglang, or apt install clang lld"
_EXPORTS = "start", "run", "count", "rows", "place"
_ZIG = ("-target", "wasm32-freestanding", "-fno-sanitize=all")
_CLANG = ("--target=wasm32", "-ffreestanding")
_COMMON = ("-Os", "-nostdlib", "-Wl,--no-entry", "-Wl,--strip-all", "-Wl,-z,stack-size=65536")


@dataclass(frozen=True)
class Column:
    """What a row tells of a node."""

    name: str
    text: str  # its expression in C
    digested: bool
    finite: bool  # a value that is not finite is a fault of the node


class Program(ClosedLoop):
    """The nodes of a rig, and what a page is told of them."""

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig)
        self.cycle_count = cycles_of(rig)
        _check(rig)
        recorded = self.columns()
        self.rows = {role: [*self._columns(role, recorded[role])] for role in self.nodes}
        self.places = {role: self._settable(role) for role in self.nodes}

    def _columns(self, role: Role, recorded: list[tuple[str, str]]) -> Iterator[Column]:
        """Yield what is digested of a node, then what its frames carry and what must be finite."""
        wiring, digested = self.nodes[role], {name for name, _ in recorded}
        variables = wiring.plan.table.variables
        judged = [
            (variables[p].name, wiring.places[p].replace("rig->", f"{role}_node.", 1))
            for _, views in wiring.blocks
            for p in views.outputs[: views.judged]
        ]
        must = {name for name, _ in judged}
        yield from (Column(name, text, True, name in must) for name, text in recorded)
        for place, variable in enumerate(variables):
            if variable.recorded and variable.kind in ("received", "sent"):
                struct, _, member = wiring.at(place).partition("->")
                where = {"received": "in", "sent": "out"}[struct]
                sent = variable.kind == "sent"
                yield Column(variable.name, f"{role}_{where}.{member}", False, sent)
        yield from (Column(*one, False, True) for one in judged if one[0] not in digested)

    def _settable(self, role: Role) -> dict[str, str]:
        """Return parameters and states of a node by name, with their places in C."""
        wiring = self.nodes[role]
        variables = wiring.plan.table.variables
        return {
            variables[p].name: wiring.places[p].replace("rig->", f"{role}_node.", 1)
            for _, views in wiring.blocks
            for p in (*views.parameters, *views.states)
        }

    def module(self) -> bytes:
        """Return the WebAssembly; UserError without a compiler."""
        command = _compiler()
        with tempfile.TemporaryDirectory() as name:
            folder, made = Path(name), Path(name) / "rig.wasm"
            fixed_files(folder)
            sources = [folder / "codec.c", *write(self.around("\n".join(self._web())), folder)]
            exports = [f"-Wl,--export={one}" for one in _EXPORTS]
            run([*command, *FLAGS, *WARNINGS, *_COMMON, *exports, "-o", made, *sources])
            return made.read_bytes()

    def _web(self) -> Iterator[str]:
        roles = list(self.nodes)
        yield "/* The closed loop of a rig for a page. */"
        yield f"#define CYCLES {self.cycle_count + 1}U /* of the lower nodes */"
        yield f"#define BATCH {BATCH}U"
        yield from self.declared()
        yield "static void cost_begin(void)\n{\n}\n\nstatic void cost_end(void)\n{\n}\n"
        for role, columns in self.rows.items():
            yield f"static double {role}_rows[BATCH + 1U][{max(1, len(columns))}];"
            yield f"static uint32_t {role}_count;\n\nstatic void {role}_mix(void)\n{{"
            yield f"    double *row = {role}_rows[{role}_count];\n    (void)row;"
            yield from (f"    row[{i}] = (double){one.text};" for i, one in enumerate(columns))
            yield f"    {role}_count += 1U;\n}}\n"
        yield from self.cycles()
        yield from (f"{one};" for one in _PROTOTYPES)
        yield f"\nstatic uint32_t now;\n\n{_PROTOTYPES[0]}\n{{"
        yield f"    return {self.refused};\n}}\n\n{_PROTOTYPES[1]}\n{{"
        yield "    static uint32_t begun;\n"
        yield from (f"    {role}_count = 0U;" for role in roles)
        yield "    if (begun == 0U) {\n        begun = 1U;"
        yield from (f"        {role}_cycle(0U);" for role in reversed(roles[1:]))
        yield "    }"
        yield "    for (uint32_t i = 0U; (i < n) && (i < BATCH) && (now + 1U < CYCLES); i += 1U) {"
        yield f"        {roles[0]}_cycle(now);\n        now += 1U;"
        yield from (f"        {role}_cycle(now);" for role in reversed(roles[1:]))
        yield f"    }}\n    return now;\n}}\n\n{_PROTOTYPES[2]}\n{{"
        yield f"    const uint32_t all[] = {{{', '.join(f'{role}_count' for role in roles)}}};"
        yield f"    return all[node];\n}}\n\n{_PROTOTYPES[3]}\n{{"
        yield f"    double *const all[] = {{{', '.join(f'{role}_rows[0]' for role in roles)}}};"
        yield f"    return all[node];\n}}\n\n{_PROTOTYPES[4]}\n{{"
        for number, role in enumerate(roles):
            yield f"    if (node == {number}U) {{\n        switch (i) {{"
            for i, text in enumerate(self.places[role].values()):
                yield f"        case {i}U:\n            return (void *)&{text};"
            yield "        default:\n            break;\n        }\n    }"
        yield "    return (void *)0;\n}\n"


def _check(rig: Rig) -> None:
    """Raise RigError for what would end or hold a run in the supervisor, which a page has not."""
    config = rig.config
    for role, section in config.sections.items():
        if section.plausible:
            what = "a page does not judge what it hears; take it out"
            raise rig.error(f"{role}.plausible", what)
    if config.supervisor.arm == "manual":
        what = "a page has no operator who arms it; --set supervisor.arm=automatic"
        raise rig.error("supervisor.arm", what)
    if config.supervisor.estop:
        raise rig.error("supervisor.estop", "a page has no emergency stop; take it out")


_PROTOTYPES = (
    "int32_t start(void)",
    "uint32_t run(uint32_t n)",
    "uint32_t count(uint32_t node)",
    "double *rows(uint32_t node)",
    "void *place(uint32_t node, uint32_t i)",
)


def _compiler() -> tuple[str, ...]:
    with suppress(ImportError):
        import ziglang

        return (sys.executable, "-m", ziglang.__name__, "cc", *_ZIG)
    if shutil.which("zig"):
        return ("zig", "cc", *_ZIG)
    if shutil.which("clang") and shutil.which("wasm-ld"):
        return ("clang", *_CLANG)
    raise UserError(CURE, Exit.ENVIRONMENT)
