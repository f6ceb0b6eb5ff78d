"""What a controller costs on a Cortex-M: instructions and stack of its rig's step, at worst.

The closed loop runs in QEMU with `-icount`, where time passes with the instructions executed; what
SysTick counts during a step is compared with a loop of known length. The stack is painted before
each step. Both are the most of all cycles of the run, not a bound for other inputs.

    share = instructions CLOCKS / (168 MHz period)

CLOCKS is 2 clocks an instruction, on the safe side: a Cortex-M4 takes 1 to 1.5 for the integer code
of double in software, a Cortex-M7 less than 1 but 14 to 30 for a division or root of doubles.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.laws.block import Block
from pcpc.executive.nodes.plan import cycles_of
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.make.generate import builds
from pcpc.tools.make.generate import single as singles
from pcpc.tools.make.generate.closed import PORT, ClosedLoop
from pcpc.tools.make.generate.library import write
from pcpc.tools.make.generate.translator import elementary
from pcpc.tools.make.generate.translator.law import LETTERS, law_files, signature
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.progress import Progress

CLOCK_HZ, CLOCKS = 168e6, 2.0
CORES = ("Cortex-M7", "Cortex-M4")
_KNOWN = 100_000  # instructions of the loop of known length
_SHIFT = 6  # 2^6 ns an instruction: a step of ten million fits into SysTick
_Row = tuple[str, str, str, str, str, str, str]


def cost_table(
    rig: Rig,
    names: Sequence[str],
    settings: Sequence[str],
    cycles: int,
    in_single: bool,
    progress: Progress,
) -> list[str]:
    """Return the table of some of a rig's controllers; `in_single`: also with floats."""
    rows = [_head(rig.config.rate_hz)]
    for name in names:
        law = load_rig(rig.path, name, list(settings))
        for core in CORES:
            for single in (False, True)[: 1 + in_single]:
                progress.show(f"{name} on a {core}")
                most = step_cost(law, core, min(cycles, cycles_of(law)), single)
                rows.append(_row(name, core, single, *most, law.config.rate_hz))
    progress.close()
    return screen.table(rows, right=(3, 4, 5))


def law_cost_table(block: Block, name: str, cycles: int, progress: Progress) -> list[str]:
    """Return the table of a law, with the values that it begins with and inputs within +-1."""
    rows = [_head(1000.0)]
    for core in CORES:
        for single in (False, True):
            progress.show(f"{name} on a {core}")
            files = _law_program(block, name, cycles, single)
            rows.append(_row(name, core, single, *_cost(files, core, single), 1000.0))
    progress.close()
    return screen.table(rows, right=(3, 4, 5))


def _head(rate_hz: float) -> _Row:
    return "law", "core", "", "instructions", "stack", f"of {1e3 / rate_hz:g} ms", ""


def _row(name: str, core: str, single: bool, most: int, stack: int, rate_hz: float) -> _Row:
    share = most * CLOCKS * rate_hz / CLOCK_HZ
    fits = "fits" if share <= 1.0 else "does not fit"
    kind = "float" if single else "double"
    return name, core, kind, f"{most:,}", f"{stack:,} B", f"{share:.1%}", fits


def step_cost(rig: Rig, core: str, cycles: int, in_single: bool = False) -> tuple[int, int]:
    """Return the most instructions and bytes of stack of the executive's step; UserError."""
    return _cost(ClosedLoop(rig, in_single).files(cycles), core, in_single)


def _cost(files: dict[str, str], core: str, in_single: bool) -> tuple[int, int]:
    build = next(one for one in builds.builds() if one.name.startswith(core))
    if not build.possible:
        raise UserError(f"{core}: {build.cure}", Exit.ENVIRONMENT)
    build = builds.hard_float(build) if in_single else build
    assert build.runner is not None
    *machine, kernel = build.runner
    counting = (*machine, "-icount", f"shift={_SHIFT}", kernel)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(files, folder)
        builds.fixed_files(folder)
        said = builds.with_runner(build, counting, ("-DCOST",)).digest(folder)
    if len(said) != 80:
        raise UserError(f"{core}: the program said {said!r} instead of its cost")
    most, stack, known, empty = (int(said[16 * i : 16 * i + 16], 16) for i in range(1, 5))
    return round((most - empty) * _KNOWN / (known - empty)), stack


def _law_program(block: Block, name: str, cycles: int, in_single: bool) -> dict[str, str]:
    """Return the files of a program that steps a law alone."""
    law = law_files(block, name)
    files = (
        singles.single_precision(law) | singles.files() | elementary.files()
        if in_single
        else (law | elementary.files())
    )
    number, has = "float" if in_single else "double", signature(block)
    given = "".join(f", &{LETTERS[role]}" for role in has)
    begun = ", ".join(f"&{LETTERS[role]}" for role in has if role in ("parameters", "states"))
    draw = (
        f"        {number} *at = ({number} *)&u;\n"
        f"        for (uint32_t i = 0U; i < (uint32_t)(sizeof u / sizeof(*at)); i += 1U) {{\n"
        "            seed = seed * 1664525U + 1013904223U;\n"
        f"            at[i] = ({number})((int32_t)(seed >> 8) - 8388608) / ({number})8388608;\n"
        "        }\n"
    )
    main = [
        f'#include "{name}.h"',
        '#include "pcpc_math.h"',
        PORT.read_text(encoding="utf-8"),
        *(f"static {name}_{role} {LETTERS[role]};" for role in has),
        "int main(void)\n{\n    uint32_t seed = 1U;\n    (void)seed;\n    (void)mix;",
        f"    {name}_init({begun});",
        f"    for (uint32_t k = 0U; k < {cycles}U; k += 1U) {{",
        draw if "inputs" in has else "",
        "        cost_begin();",
        f"        {name}_step(({number})k * ({number})1e-3, ({number})1e-3{given});",
        "        cost_end();\n    }",
        "    say_hex(0U);\n    cost_say();\n    finish();",
        "    return 0;\n}\n",
    ]
    return {**files, "main.c": "\n".join(main)}
