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
from pcpc.executive.nodes.plan import cycles_of
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.console import screen
from pcpc.tools.console.progress import Progress
from pcpc.tools.generate import builds
from pcpc.tools.generate.closed import Closed
from pcpc.tools.generate.library import write

CLOCK_HZ, CLOCKS = 168e6, 2.0
_KNOWN = 100_000  # instructions of the loop of known length
_SHIFT = 6  # 2^6 ns an instruction: a step of ten million fits into SysTick


def told(rig: Rig, settings: Sequence[str], cycles: int, progress: Progress) -> list[str]:
    """Return the table of the rig's controllers; of one that was chosen, its own."""
    names = list(rig.config.controllers)
    chosen = [rig.config.controller] if len(names) > 12 else names
    rows = [
        ("controller", "core", "instructions", "stack", f"of {1e3 / rig.config.rate_hz:g} ms", "")
    ]
    for name in chosen:
        law = load_rig(rig.path, name, list(settings))
        for core in ("Cortex-M7", "Cortex-M4"):
            progress.show(f"{name} on a {core}")
            instructions, stack = measured(law, core, min(cycles, cycles_of(law)))
            share = instructions * CLOCKS * law.config.rate_hz / CLOCK_HZ
            fits = "fits" if share <= 1.0 else "does not fit"
            rows.append((name, core, f"{instructions:,}", f"{stack:,} B", f"{share:.1%}", fits))
    progress.close()
    return screen.table(rows, right=(2, 3, 4))


def measured(rig: Rig, core: str, cycles: int) -> tuple[int, int]:
    """Return the most instructions and bytes of stack of the executive's step; UserError."""
    build = next(one for one in builds.builds() if one.name.startswith(core))
    if not build.possible:
        raise UserError(f"{core}: {build.cure}", Exit.ENVIRONMENT)
    assert build.runner is not None
    *machine, kernel = build.runner
    counting = (*machine, "-icount", f"shift={_SHIFT}", kernel)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(Closed(rig).files(cycles), folder)
        builds.fixed_files(folder)
        said = builds.with_runner(build, counting, ("-DCOST",)).digest(folder)
    if len(said) != 80:
        raise UserError(f"{core}: the program said {said!r} instead of its cost")
    most, stack, known, empty = (int(said[16 * i : 16 * i + 16], 16) for i in range(1, 5))
    return round((most - empty) * _KNOWN / (known - empty)), stack
