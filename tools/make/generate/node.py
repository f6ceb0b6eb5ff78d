"""The blocks of one node of a rig in C, in their order and wired: `NAME_rig.h` and `NAME_rig.c`.

    NAME_received, NAME_sent      what frames carry, FRAME_signal in the order of the DBC file
    NAME_rig                      parameters, states, inputs, outputs of all blocks, BLOCK_p, ...
        .loop                     what the rig transmits of the loop itself, set by who calls
    NAME_rig_init                 the rig's values after `prepare`; not 0: the self-test refuses
    NAME_rig_step                 cycle k: tunings of `schedule`, blocks, `transmit`
    NAME_rig_limit                what is sent, within `limits`: as `executive.loop.limits`

Frames, counters, CRC and the supervisor stand around it.
"""

from collections.abc import Iterator, Sequence

from pcpc.executive.loop.limits import FINITE
from pcpc.executive.loop.table import Variable
from pcpc.executive.nodes.plan import cycles_of, plan
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.make.generate import single
from pcpc.tools.make.generate.translator import elementary
from pcpc.tools.make.generate.translator.kinds import Untranslatable, number_text
from pcpc.tools.make.generate.translator.law import LETTERS, signature
from pcpc.tools.make.generate.translator.source import comment_text
from pcpc.tools.make.generate.translator.unit import wrapped_lines
from pcpc.tools.make.generate.wiring import Wiring
from pcpc.tools.make.generate.words import identifier


class NodeWiring(Wiring):
    """What a node's functions have of its table behind `rig->`, `received->`, `sent->`."""

    def __init__(self, rig: Rig, role: Role, name: str) -> None:
        self.name = name
        self.loop: dict[str, str] = {}  # variables of the loop itself that blocks or frames take
        super().__init__(plan(rig, role, "lockstep"))
        if self.plan.faults:
            raise Untranslatable(f"{rig.path}: faults on purpose have no C; take them out")

    def part(self, spec: BlockSpec, role: str) -> str:
        """Return the expression of one of a block's structs."""
        return f"rig->{identifier(spec.name)}_{LETTERS[role]}"

    def other(self, variable: Variable) -> str:
        """Return what a frame carries, or what is noted as one of the loop's own variables."""
        if variable.kind in ("received", "sent"):
            return f"{variable.kind}->{_signal(variable)}"
        self.loop[identifier(variable.name)] = variable.help
        return f"rig->loop.{identifier(variable.name)}"

    def law(self, spec: BlockSpec) -> str:
        """Return the name of a block's law in C."""
        return f"{self.name}_{super().law(spec)}"

    def struct_members(self) -> list[str]:
        """Return the members of NAME_rig that are doubles."""
        return [
            f"{self.law(spec)}_{role} {identifier(spec.name)}_{LETTERS[role]};"
            for spec, _ in self.blocks
            for role in signature(spec.block)
        ]


def _signal(variable: Variable) -> str:
    return identifier(variable.name.partition(".")[2])


def rig_files(
    rig: Rig, role: Role = "executive", name: str = "", in_single: bool = False
) -> dict[str, str]:
    """Return all files of a node: its laws, the elementary functions, `NAME_rig.h` and `.c`.

    `name` "": that of the rig; `in_single`: with floats. Raises Untranslatable, RigError.
    """
    name = name or identifier(rig.config.rig)
    wiring = NodeWiring(rig, role, name)
    files: dict[str, str] = {}
    for spec, views in wiring.blocks:
        files |= wiring.law_files(spec, views)
    steps = list(_steps(wiring))  # first: it finds out what of the loop is needed
    files[f"{name}_rig.h"] = "\n".join(p for line in _header(wiring) for p in wrapped_lines(line))
    files[f"{name}_rig.c"] = "\n".join(
        p for line in _body(wiring, steps) for p in wrapped_lines(line)
    )
    return (
        single.single_precision(files) | single.files() if in_single else files | elementary.files()
    )


def _header(wiring: NodeWiring) -> Iterator[str]:
    name, rig = wiring.name, wiring.plan.rig
    guard = f"PCPC_{name.upper()}_RIG_H"
    about = f"{rig.config.rig}: {rig.config.title}. Node {wiring.plan.spec.name} of the rig"
    yield f"/* {comment_text(about)}, made by `pcpc generate c`. */"
    yield from (f"#ifndef {guard}", f"#define {guard}", "", "#include <stdbool.h>")
    yield from ("#include <stdint.h>", "")
    yield from (f'#include "{wiring.law(spec)}.h"' for spec, _ in wiring.blocks)
    yield from ("", f"#define {name.upper()}_PERIOD_S {number_text(wiring.period_s)}")
    yield from (f"#define {name.upper()}_CYCLES {cycles_of(rig)}U", "")
    for kind, what in (("received", "hears"), ("sent", "sends")):
        yield f"/* What the frames carry that this node {what}. */"
        yield "typedef struct {"
        for variable in wiring.plan.table.variables:
            if variable.kind == kind:
                words = comment_text(f"[{variable.unit or '1'}] {variable.help}")
                yield f"    double {_signal(variable)}; /* {words} */"
        yield from (f"}} {name}_{kind};", "")
    if wiring.loop:
        yield "/* What is sent of the loop itself; who calls sets it before each step. */"
        yield "typedef struct {"
        yield from (f"    double {its}; /* {comment_text(h)} */" for its, h in wiring.loop.items())
        yield from (f"}} {name}_loop;", "")
    yield "/* All blocks: p parameters, x states, u inputs, y outputs. */"
    yield "typedef struct {"
    yield from (f"    {member}" for member in wiring.struct_members())
    if wiring.loop:
        yield f"    {name}_loop loop;"
    for what in ("last", "before") if wiring.plan.limits else ():
        words = "before a ramp" if what == "last" else "in the cycle before"
        yield f"    double {what}[{len(wiring.plan.limits)}]; /* commands sent {words} */"
    yield from ("    int32_t refused; /* by the self-test; then a step does nothing */",)
    yield from (f"}} {name}_rig;", "")
    yield "/* Set the values that the rig starts with. Return 0, or what the self-test says. */"
    yield from (f"int32_t {name}_rig_init({name}_rig *rig);", "")
    yield "/* Cycle k: from what was received to what is to be sent. Return 0, or as init. */"
    yield from (f"{_step_head(name)};", "")
    yield "/* Keep commands within their limits: range and rate. `waits`: they are safe; `ramping`:"
    yield " * they fall from the last ones to safe with `gain` 1..0; else they rise with it. Return"
    yield " * how many were limited, -1 if one was no finite number (its last value is sent). */"
    yield from (f"{_limit_head(name)};", "", f"#endif /* {guard} */", "")


def _step_head(name: str) -> str:
    given = f"const {name}_received *received, {name}_sent *sent"
    return f"int32_t {name}_rig_step({name}_rig *rig, uint32_t cycle, {given})"


def _limit_head(name: str) -> str:
    given = f"bool waits, bool ramping, double gain, {name}_sent *sent"
    return f"int32_t {name}_rig_limit({name}_rig *rig, {given})"


def _body(wiring: NodeWiring, steps: Sequence[str]) -> Iterator[str]:
    name = wiring.name
    yield f"/* The blocks of {comment_text(wiring.plan.spec.name)}, wired as the rig says. */"
    yield from ("", f'#include "{name}_rig.h"', "", '#include "pcpc_math.h"', "")
    yield from _init(wiring)
    yield from steps
    yield from _limits(wiring)


def _init(wiring: NodeWiring) -> Iterator[str]:
    name, plan_ = wiring.name, wiring.plan
    zeroed = [m for m in wiring.struct_members() if m.endswith(("_u;", "_y;"))]
    if zeroed or wiring.loop:
        yield "static void zero(double *values, uint32_t bytes)"
        yield "{"
        yield "    for (uint32_t i = 0U; i < (bytes / sizeof(double)); i += 1U) {"
        yield from ("        values[i] = 0.0;", "    }", "}", "")
    yield f"int32_t {name}_rig_init({name}_rig *rig)"
    yield "{"
    for spec, _ in wiring.blocks:
        yield f"    {wiring.law(spec)}_init({', '.join(wiring.pointers(spec, 'px'))});"
    for member in (*zeroed, *(["x loop;"] if wiring.loop else [])):
        its = member.split()[1].rstrip(";")
        yield f"    zero((double *)&rig->{its}, (uint32_t)sizeof(rig->{its}));"
    for _, views in wiring.blocks:
        for place in views.outputs:
            if plan_.values.get(place, 0.0) != 0.0:
                yield f"    {wiring.places[place]} = {number_text(plan_.values[place])};"
    for i, (_, (*_, safe)) in enumerate(wiring.limits()):
        yield f"    rig->last[{i}] = {number_text(safe)};"
        yield f"    rig->before[{i}] = {number_text(safe)};"
    tests = " | ".join(f"{wiring.law(spec)}_selftest()" for spec, _ in wiring.blocks)
    yield f"    rig->refused = {tests or 'pcpc_selftest()'};"
    yield from ("    return rig->refused;", "}", "")


def _steps(wiring: NodeWiring) -> Iterator[str]:
    name, plan_ = wiring.name, wiring.plan
    yield _step_head(name)
    yield "{"
    yield f"    const double dt = {name.upper()}_PERIOD_S;"
    yield "    const double t = (double)cycle * dt;"
    yield from ("", "    (void)received;", "    (void)sent;", "    (void)t;")
    yield from ("    if (rig->refused != 0) {", "        return rig->refused;", "    }")
    for cycle, place, value in plan_.schedule:
        variable = plan_.table.variables[place]
        if place not in wiring.places:
            what = f"schedule: {variable.name} is of the loop, which has no C"
            raise Untranslatable(f"{plan_.rig.path}: {what}; tune blocks only")
        yield f"    if (cycle == {cycle}U) {{"
        yield f"        {wiring.at(place)} = {number_text(value)};"
        yield "    }"
    wiring.places[plan_.table.index["time.t_s"]] = "t"
    for spec, _ in wiring.blocks:
        yield from ("", *wiring.step(spec, "t", "dt"))
    yield from ("", *wiring.copies(-1))
    yield from ("    return 0;", "}", "")


def _limits(wiring: NodeWiring) -> Iterator[str]:
    """Yield NAME_rig_limit: `limit_commands` of the loop, command by command."""
    name, plan_ = wiring.name, wiring.plan
    if plan_.limits:
        yield from _LIMITED.splitlines()
        yield ""
    yield _limit_head(name)
    yield "{"
    if not plan_.limits:
        yield from (f"    (void){its};" for its in ("rig", "waits", "ramping", "gain", "sent"))
        yield from ("    return 0;", "}", "")
        return
    yield from ("    int32_t count = 0;", "    bool odd = false;", "")
    for i, (at, values) in enumerate(wiring.limits()):
        yield "    {"
        yield f"        const limits its = {{{', '.join(map(number_text, values))}}};"
        yield f"        if (!(pcpc_abs({at}) < {number_text(FINITE)})) {{"
        yield "            odd = true;"
        yield f"            {at} = rig->last[{i}];"
        yield "        }"
        yield (
            f"        count += limited(&{at}, &rig->last[{i}], &rig->before[{i}], &its, waits,"
            " ramping, gain);"
        )
        yield "    }"
    yield from ("    return odd ? -1 : count;", "}", "")


_LIMITED = """\
typedef struct {
    double low;
    double high;
    double step; /* the most that it may change in a cycle */
    double safe;
} limits;

/* Keep one command within its limits; return 1 if that changed it. */
static int32_t limited(double *command, double *last, double *before, const limits *its,
        bool waits, bool ramping, double gain)
{
    double wanted = waits ? its->safe : *command;

    if (ramping) {
        wanted = (its->safe == 0.0) ? gain * *last : its->safe + gain * (*last - its->safe);
    } else if (gain < 1.0) {
        wanted = its->safe + gain * (wanted - its->safe);
    }
    double value = (its->low > wanted) ? its->low : wanted;
    value = (its->high < value) ? its->high : value;
    value = ((*before - its->step) > value) ? *before - its->step : value;
    value = ((*before + its->step) < value) ? *before + its->step : value;
    *before = value;
    *command = value;
    if (ramping) {
        return 0;
    }
    *last = ((gain < 1.0) && (gain > 0.0)) ? its->safe + (value - its->safe) / gain : value;
    return (value != wanted) ? 1 : 0;
}"""
